"""Poses as matrices, transposed or inverted, and poses in a file each."""

import numpy as np
import pytest

import handeye_fg as hf
from handeye_fg.errors import InputDataError
from pose_files import (
    EXPECTED,
    HALF,
    IMAGES,
    POSITIONS,
    THIRD,
    assert_expected,
    flat,
    joined,
    written,
)


def test_inverted_poses_are_turned_back(tmp_path):
    inverse = [joined(flat(np.linalg.inv(matrix))) for matrix in EXPECTED]
    path = written(tmp_path, "poses.txt", f"a_0.png {inverse[0]}\na_1.png {inverse[1]}\n")
    assert_expected(hf.read_poses(path, inverted=True), IMAGES)


def test_transposed_rotations(tmp_path):
    lines = [
        f"{image} {joined(flat(np.vstack([np.column_stack([matrix[:3, :3].T, matrix[:3, 3]]), matrix[3]])))}"
        for image, matrix in zip(IMAGES, EXPECTED, strict=True)
    ]
    path = written(tmp_path, "poses.txt", "\n".join(lines))
    assert_expected(hf.read_poses(path, rotation="matrix-transposed"), IMAGES)


def test_blocks_of_four_lines_are_matrices(tmp_path):
    blocks = [f"# {i}\n" + "\n".join(map(joined, matrix)) for i, matrix in enumerate(EXPECTED)]
    path = written(tmp_path, "poses.txt", "\n\n".join(blocks))
    assert_expected(hf.read_poses(path, images=IMAGES, pair_by="order"), IMAGES)


@pytest.mark.parametrize("shape", [(2, 4, 4), (2, 3, 4), (2, 16), (2, 12)])
def test_arrays(tmp_path, shape):
    count = int(np.prod(shape[1:]))
    rows = EXPECTED.reshape(2, 16)[:, :count]
    np.save(tmp_path / "poses.npy", rows.reshape(shape))
    poses = hf.read_poses(tmp_path / "poses.npy", images=IMAGES, pair_by="order")
    assert_expected(poses, IMAGES)


ZIVID = """__version__:
  serializer: 1
  data: 1
FloatMatrix:
  Data:
    [
      [{}, {}, {}, {}],
      [{}, {}, {}, {}],
      [{}, {}, {}, {}],
      [{}, {}, {}, {}],
    ]
"""
VISP = "# pose of the effector\nrows: 6\ncols: 1\ndata:\n" + "  - [{}]\n" * 6
POSE = "x: {}\ny: {}\nz: {}\nqx: {}\nqy: {}\nqz: {}\nqw: {}\n"


def test_a_file_for_each_pose(tmp_path):
    in_mm = EXPECTED.copy()
    in_mm[:, :3, 3] *= 1000.0
    vectors = [[THIRD] * 3, [0, 0, np.pi / 2]]
    for i in (0, 1):
        written(tmp_path / "zivid", f"pos0{i}.yaml", ZIVID.format(*flat(in_mm[i])))
        pose = VISP.format(*POSITIONS[i], *vectors[i])
        written(tmp_path / "visp", f"pose_fPe_{i}.yaml", pose)
        written(tmp_path / "text", f"a_{i}.txt", "\n".join(map(joined, EXPECTED[i])))
    for name, folder in (("zivid", "zivid"), ("visp", "visp"), ("matrix", "text")):
        for format_ in (name, "auto"):
            assert_expected(hf.read_poses(tmp_path / folder, format_, images=IMAGES), IMAGES)


def test_robot_cal_tools(tmp_path):
    rotations = [[0.5] * 4, [0, 0, HALF, HALF]]
    for i in (0, 1):
        written(tmp_path / "poses", f"{i}.yaml", POSE.format(*POSITIONS[i], *rotations[i]))
    index = "- pose: poses/0.yaml\n  image: a_0.png\n- pose: poses/1.yaml\n  image: a_1.png\n"
    path = written(tmp_path, "data.yaml", index)
    for name in ("robot-cal-tools", "auto"):
        assert_expected(hf.read_poses(path, name, images=IMAGES), IMAGES)
    path = written(tmp_path, "data.yaml", index.replace("poses/0", "../../poses/0"))
    with pytest.raises(InputDataError, match="leads out"):
        hf.read_poses(path)
    path = written(tmp_path, "data.yaml", index.replace("0.yaml", "0.exe"))
    with pytest.raises(InputDataError, match=r"data\.yaml: names pose files that do not end in"):
        hf.read_poses(path)
    with pytest.raises(InputDataError, match=r"none\.yaml: no such file; check the path"):
        hf.read_poses(tmp_path / "none.yaml")
