import warnings
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from handeye_fg.frames import inverse, pose
from handeye_fg.io.poses import FORMATS, open_poses, write_poses
from handeye_fg.options import PoseFileOptions
from handeye_fg.types import RobotPoses

quick = settings(max_examples=15, suppress_health_check=[HealthCheck.function_scoped_fixture])
FILES = {"ros": "poses.yaml", "moveit": "poses.yaml", "robot-cal-tools": "data.yaml"}

coordinates = st.floats(-5.0, 5.0)
# Quarter turns bring the angles of every sequence into gimbal lock.
quarters = st.sampled_from([0.0, np.pi / 2, -np.pi / 2, np.pi])
vectors = st.tuples(*[st.floats(-np.pi, np.pi) | quarters] * 3)
names = st.text(
    st.characters(codec="utf-8", exclude_characters="\0\r/\\:."), min_size=1, max_size=8
).filter(lambda name: name.strip() != "")


def poses_of(rows: dict[str, tuple]) -> RobotPoses:
    rotations = Rotation.from_rotvec([vector for _, vector in rows.values()]).as_matrix()
    return RobotPoses(
        names=tuple(rows),
        base_T_gripper=pose(rotations, np.array([position for position, _ in rows.values()])),
    )


def path_of(folder: Path, name: str) -> Path:
    return folder / FILES.get(name, "poses.txt")


def options_of(name: str, **known) -> PoseFileOptions:
    how = {"image": "name", "time": "time", "none": "order"}[FORMATS[name].key]
    how = "name" if FORMATS[name].container in {"folder", "index"} else how
    return PoseFileOptions(format=name, pair_by=how, **known)


def tolerance(name: str, poses: RobotPoses, inverted: bool) -> float:
    """Within 1e-7 rad of gimbal lock the angle of one axis is written as none."""
    convention = FORMATS[name].convention
    if convention.size != 3 or convention.rotation == "rotation-vector":
        return 1e-9
    written = inverse(poses.base_T_gripper) if inverted else poses.base_T_gripper
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        try:
            Rotation.from_matrix(written[:, :3, :3]).as_euler(convention.rotation)
        except UserWarning:
            return 1e-6
    return 1e-9


@pytest.mark.parametrize("name", FORMATS)
@quick
@given(data=st.data())
def test_what_is_written_is_read(tmp_path_factory, name: str, data: st.DataObject) -> None:
    known = data.draw(
        st.fixed_dictionaries(
            {
                "units": st.sampled_from(["m", "mm"]),
                "angles": st.sampled_from(["rad", "deg"]),
                "inverted": st.booleans(),
            }
        )
    )
    if FORMATS[name].key == "image":
        keys = names.map(lambda text: f"{text}.png")
    else:  # order and time of images: by their names
        keys = st.integers(10**9, 10**10 - 1).map(lambda ns: f"{1700 * 10**15 + ns}.png")
    rows = data.draw(
        st.dictionaries(
            keys, st.tuples(st.tuples(*[coordinates] * 3), vectors), min_size=1, max_size=5
        )
    )
    poses = poses_of(dict(sorted(rows.items())))
    options = options_of(name, **known)
    path = path_of(tmp_path_factory.mktemp("poses"), name)
    write_poses(poses, path, options)
    read = open_poses(path, options, poses.names).poses()
    assert read.names == poses.names
    atol = tolerance(name, poses, known["inverted"])
    np.testing.assert_allclose(read.base_T_gripper, poses.base_T_gripper, rtol=0.0, atol=atol)
