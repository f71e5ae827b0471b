"""Rows find their images by name and by time; by number and order only if asked for."""

from math import cos, pi, sin

import numpy as np
import pytest

import handeye_fg as hf
from handeye_fg.errors import InputDataError
from handeye_fg.io.poses.pairing import time_ns, time_of_name


def turned(angle):
    """About z, by hand."""
    return [[cos(angle), -sin(angle), 0], [sin(angle), cos(angle), 0], [0, 0, 1]]


def tum(times, folder):
    """An arm that turns about z by 1 rad and moves along x by 1 m in a second."""
    lines = [f"{1700000000 + t:.6f} {t!r} 0 0 0 0 {sin(t / 2)!r} {cos(t / 2)!r}" for t in times]
    path = folder / "poses.tum"
    path.write_text("\n".join(lines))
    return path


def images(*times):
    return tuple(f"cam_{1700000000 + t:.6f}.png" for t in times)


def kitti(count, folder):
    path = folder / "poses.txt"
    path.write_text("".join(f"1 0 0 {i} 0 1 0 0 0 0 1 0\n" for i in range(count)))
    return path


def rows_of(poses):
    return {
        name: matrix[0, 3] for name, matrix in zip(poses.names, poses.base_T_gripper, strict=True)
    }


def test_poses_between_times_are_interpolated(tmp_path):
    path = tum([0.3, 0.0, 0.1, 0.2], tmp_path)  # in any order
    poses = hf.read_poses(path, images=images(0.025, 0.1, 0.27))
    assert poses.names == images(0.025, 0.1, 0.27)
    for matrix, t in zip(poses.base_T_gripper, (0.025, 0.1, 0.27), strict=True):
        # Times have microseconds: 1 um and 1 urad of this motion.
        np.testing.assert_allclose(matrix[:3, :3], turned(t), atol=2e-6)
        np.testing.assert_allclose(matrix[:3, 3], [t, 0, 0], atol=2e-6)


def test_half_turns_and_more_do_not_matter_to_interpolation(tmp_path):
    path = tmp_path / "p.tum"  # the same rotations as quaternions of both signs
    path.write_text("1700000000.0 0 0 0 0 0 0 1\n1700000000.1 0 0 0 0 0 0 -1\n")
    poses = hf.read_poses(path, images=images(0.05))
    np.testing.assert_allclose(poses.base_T_gripper[0], np.eye(4), atol=1e-15)


def test_images_too_far_from_a_pose_are_left_out(tmp_path):
    path = tum([0.0, 0.1, 0.5, 0.6], tmp_path)
    around = images(-0.05, 0.05, 0.3, 0.55, 0.65)
    assert hf.read_poses(path, images=around).names == images(0.05, 0.55)
    wide = hf.read_poses(path, images=around, time_tolerance_s=0.25)
    assert wide.names == images(0.05, 0.3, 0.55)
    with pytest.raises(InputDataError, match=r"within 0.1 s .*the nearest are 0.2 s apart"):
        hf.read_poses(path, images=images(0.3))


def test_the_nearest_pose_for_an_arm_that_stood_still(tmp_path):
    path = tum([0.0, 1.0, 2.0], tmp_path)
    poses = hf.read_poses(path, images=images(0.04, 1.96, 1.5), pair_by="nearest-time")
    assert rows_of(poses) == dict(zip(images(0.04, 1.96), (0.0, 2.0), strict=True))


def test_a_millisecond_is_the_same_instant(tmp_path):
    path = tum([0.0, 1.0], tmp_path)
    names = images(0.0009, 0.9991, 0.002)
    assert rows_of(hf.read_poses(path, images=names)) == dict(zip(names, (0.0, 1.0), strict=False))


def test_times_of_two_poses_are_never_the_same(tmp_path):
    line = "1700000000.0 {} 0 0 0 0 0 1\n"
    path = tmp_path / "p.tum"
    path.write_text(line.format(1) * 2 + "1700000000.05 1 0 0 0 0 0 1")
    assert hf.read_poses(path, images=images(0.02)).names == images(0.02)
    path.write_text(line.format(1) + line.format(2))
    with pytest.raises(InputDataError, match="line 2: another pose has the same time"):
        hf.read_poses(path, images=images(0.0))


def test_images_of_several_cameras_share_poses(tmp_path):
    names = [f"{camera}/{name}" for camera in ("cam0", "cam1") for name in images(0.0, 0.05)]
    assert hf.read_poses(tum([0.0, 0.1], tmp_path), images=names).names == images(0.0, 0.05)


@pytest.mark.parametrize(
    ("text", "ns"),
    [
        ("1403636579.763555584", 1403636579763555584),
        ("1403636579763555584", 1403636579763555584),
        ("1403636579763", 1403636579763000000),
        ("1403636579763555", 1403636579763555000),
        ("1.403636579763555e+18", 1403636579763555000),
        ("1403636579763555584.0", 1403636579763555584),
        ("0,5", 5 * 10**8),
        (".5", 5 * 10**8),
        ("-1.5", -15 * 10**8),
        ("7", 7 * 10**9),
        ("", None),
        ("1e99", None),
        ("9" * 19, None),
        ("1.5.5", None),
    ],
)
def test_times_in_any_unit(text, ns):
    assert time_ns(text) == ns


@pytest.mark.parametrize(
    ("name", "ns"),
    [
        ("1403636579763555584.png", 1403636579763555584),
        ("left_1403636579.763555.jpg", 1403636579763555000),
        ("cam1-12.250.png", 12250 * 10**6),
        ("frame_0017.png", None),  # a count, not a time
        ("17.png", None),
        ("photo.png", None),
    ],
)
def test_times_in_names(name, ns):
    assert time_of_name(name) == ns


def test_order_is_never_silent(tmp_path):
    path = kitti(12, tmp_path)
    names = [f"{i}.png" for i in range(12)]
    with pytest.raises(InputDataError, match=r"--pair-by number .* or --pair-by order"):
        hf.read_poses(path, images=names)
    expected = {f"{i}.png": float(i) for i in range(12)}  # 10 after 9, not after 1
    for how in ("order", "number"):
        assert rows_of(hf.read_poses(path, images=names, pair_by=how)) == expected
    with pytest.raises(InputDataError, match="12 poses cannot be paired with 11 images by order"):
        hf.read_poses(path, images=names[1:], pair_by="order")
    some = hf.read_poses(path, images=names[3:5], pair_by="number")
    assert rows_of(some) == {"3.png": 3.0, "4.png": 4.0}
    with pytest.raises(InputDataError, match=r"numbers 0 to 11, but there is an image '12\.png'"):
        hf.read_poses(path, images=[*names[1:], "12.png"], pair_by="number")
    with pytest.raises(InputDataError, match="have no image names, which --pair-by name needs"):
        hf.read_poses(path, images=names, pair_by="name")
    with pytest.raises(InputDataError, match="have no times, which --pair-by time needs"):
        hf.read_poses(path, images=names, pair_by="time")
    with pytest.raises(InputDataError, match="have no names, which --pair-by name needs"):
        hf.read_poses(path, pair_by="name")


def test_times_that_are_numbers_of_images(tmp_path):
    path = tmp_path / "p.tum"
    path.write_text("3 3 0 0 0 0 0 1\n1 1 0 0 0 0 0 1\n")
    names = ["frame_01.png", "frame_02.png", "frame_03.png"]
    with pytest.raises(InputDataError, match="its rows have times, but the images' names do not"):
        hf.read_poses(path, images=names)
    poses = hf.read_poses(path, images=names, pair_by="number")
    assert rows_of(poses) == {"frame_01.png": 1.0, "frame_03.png": 3.0}
    with pytest.raises(
        InputDataError, match=r"no row has the number of an image, such as 'frame_07"
    ):
        hf.read_poses(path, images=["frame_07.png"], pair_by="number")


@pytest.mark.parametrize(
    ("header", "time"),
    [("timestamp [ns]", 25 * 10**8), ("t_ms", 2500), ("time(us)", 25 * 10**5), ("stamp [s]", 2.5)],
)
def test_units_of_times_in_the_header(tmp_path, header, time):
    path = tmp_path / "p.csv"
    path.write_text(f"{header},x,y,z,qx,qy,qz,qw\n{time},1,2,3,0,0,0,1\n")
    assert hf.read_poses(path, images=["a2.500.png"]).names == ("a2.500.png",)


def test_numbers_that_two_images_share_pair_nothing(tmp_path):
    with pytest.raises(InputDataError, match="2 of 3 have none or share it"):
        hf.read_poses(kitti(3, tmp_path), images=["a1.png", "b1.png", "2.png"], pair_by="number")


def test_rows_without_images_name_themselves(tmp_path):
    assert hf.read_poses(kitti(2, tmp_path)).names == ("row 0", "row 1")
    names = hf.read_poses(tum([0.5, 0.75], tmp_path)).names
    assert names == ("1700000000.500000000", "1700000000.750000000")
    poses = hf.read_poses(tum([0.0, 0.1], tmp_path), images=["1700000000.050000000"])
    np.testing.assert_allclose(poses.base_T_gripper[0, :3, :3], turned(0.05), atol=1e-12)


def test_files_of_poses_belong_to_the_images_with_their_names(tmp_path):
    for name in ("b.png.txt", "c.txt", "x.txt"):
        (tmp_path / name).write_text(f"1 0 0 {ord(name[0])} 0 1 0 0 0 0 1 0")
    poses = hf.read_poses(tmp_path, images=["b.png", "c.png", "d.png"])
    assert rows_of(poses) == {"b.png": ord("b"), "c.png": ord("c"), "x": ord("x")}


def test_turns_about_another_axis_than_the_first_pose(tmp_path):
    """From the cycle of the axes on, a quarter turn about the gripper's own z."""
    cycle = np.array([[0, 0, 1], [1, 0, 0], [0, 1, 0]])
    lines = [
        f"{1700000000 + t / 20} {' '.join(map(str, np.column_stack([cycle @ turned(t * pi / 4), np.zeros(3)]).ravel()))}"
        for t in (0, 2)
    ]
    path = tmp_path / "p.txt"
    path.write_text("\n".join(lines))
    (matrix,) = hf.read_poses(path, "matrix", images=images(0.05)).base_T_gripper
    np.testing.assert_allclose(matrix[:3, :3], cycle @ turned(pi / 4), atol=1e-6)


def test_quarter_turn_interpolates_about_its_axis(tmp_path):
    path = tmp_path / "p.tum"
    path.write_text(
        f"1700000000.0 0 0 0 0 0 0 1\n1700000000.1 1 0 0 0 0 {sin(pi / 4)} {cos(pi / 4)}\n"
    )
    (matrix,) = hf.read_poses(path, images=images(0.025)).base_T_gripper
    np.testing.assert_allclose(matrix[:3, :3], turned(pi / 8), atol=1e-12)
    assert matrix[0, 3] == pytest.approx(0.25, abs=1e-12)
