"""Formats of robot controllers against rotations from textbook formulas alone."""

from math import cos, degrees, radians, sin

import numpy as np
import pytest

import handeye_fg as hf
from handeye_fg.errors import InputDataError
from pose_files import HALF, IMAGES, MM, POSITIONS, THIRD, assert_expected, joined, written


def x(angle):
    return np.array(
        [[1, 0, 0], [0, cos(angle), -sin(angle)], [0, sin(angle), cos(angle)]], dtype=float
    )


def y(angle):
    return np.array(
        [[cos(angle), 0, sin(angle)], [0, 1, 0], [-sin(angle), 0, cos(angle)]], dtype=float
    )


def z(angle):
    return np.array(
        [[cos(angle), -sin(angle), 0], [sin(angle), cos(angle), 0], [0, 0, 1]], dtype=float
    )


CONTROLLERS = {
    "kuka": ("A,B,C", lambda a, b, c: z(a) @ y(b) @ x(c)),
    "fanuc": ("W,P,R", lambda w, p, r: z(r) @ y(p) @ x(w)),
    "yaskawa": ("Rx,Ry,Rz", lambda rx, ry, rz: z(rz) @ y(ry) @ x(rx)),
    "kawasaki": ("O,A,T", lambda o, a, t: z(o) @ y(a) @ z(t)),
    "mitsubishi": ("A,B,C", lambda a, b, c: z(c) @ y(b) @ x(a)),
}


@pytest.mark.parametrize("name", CONTROLLERS)
@pytest.mark.parametrize("unit", ["deg", "rad"])
def test_angles_of_controllers(tmp_path, name, unit):
    columns, rotation = CONTROLLERS[name]
    angles = [(-170.0, 35.0, 62.5), (10.0, -20.0, 30.0)]
    rows = [
        f"a_{i}.png,{MM[i]},{joined(row if unit == 'deg' else map(radians, row), ',')}"
        for i, row in enumerate(angles)
    ]
    path = written(tmp_path, "poses.csv", "\n".join([f"image,X,Y,Z,{columns}", *rows]))
    poses = hf.read_poses(path, name, angles=unit)
    for matrix, row, position in zip(poses.base_T_gripper, angles, POSITIONS, strict=True):
        np.testing.assert_allclose(matrix[:3, :3], rotation(*map(radians, row)), atol=1e-14)
        np.testing.assert_allclose(matrix[:3, 3], position, atol=1e-15)


NOTATIONS = {
    "ur": (
        f"a_0.png p[0.5, -0.25, 0.125, {THIRD}, {THIRD}, {THIRD}]",
        f"a_1.png p[0.6, 0.1, 0.3, 0.0, 0.0, {np.pi / 2}]",
    ),
    "abb": (
        "a_0.png: [[500,-250,125],[0.5,0.5,0.5,0.5],[0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]];",
        f"a_1.png: [[600,100,300],[{HALF},0,0,{HALF}],[0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]];",
    ),
    "kuka": (
        "a_0.png = {E6POS: X 500.0,Y -250.0,Z 125.0,A 90.0,B 0.0,C 90.0,S 2,T 35}",
        "a_1.png = {E6POS: X 600.0,Y 100.0,Z 300.0,A 90.0,B 0.0,C 0.0,S 2,T 35}",
    ),
}


@pytest.mark.parametrize("name", NOTATIONS)
def test_notations_of_controllers_tell_their_format(tmp_path, name):
    path = written(tmp_path, "poses.txt", "\n".join(NOTATIONS[name]))
    assert_expected(hf.read_poses(path), IMAGES)
    bare = [line[7:].lstrip(": =") for line in NOTATIONS[name]]
    path = written(tmp_path, "poses.txt", "\n".join(bare))
    assert_expected(hf.read_poses(path, name, images=IMAGES, pair_by="order"), IMAGES)
    path = written(tmp_path, "poses.txt", f"{bare[0]}\nHOME")
    with pytest.raises(InputDataError, match="line 2: no pose of"):
        hf.read_poses(path)
    path = written(tmp_path, "poses.txt", f"{bare[0]} {bare[1]}")
    with pytest.raises(InputDataError, match="line 1: holds several poses"):
        hf.read_poses(path)
    path = written(tmp_path, "poses.txt", f"{NOTATIONS[name][0]}\n{bare[1]}")
    with pytest.raises(InputDataError, match="line 2: names no image before its pose"):
        hf.read_poses(path)


def test_rotation_vectors_in_degrees_and_millimetres(tmp_path):
    rows = f"a_0.png,{MM[0]},{degrees(THIRD)},{degrees(THIRD)},{degrees(THIRD)}\na_1.png,{MM[1]},0,0,90\n"
    path = written(tmp_path, "poses.csv", f"image,x_mm,y_mm,z_mm,rx_deg,ry_deg,rz_deg\n{rows}")
    assert_expected(hf.read_poses(path, "ur"), IMAGES)  # units as the header states them
    with pytest.raises(InputDataError, match="its header says mm, but --units says m"):
        hf.read_poses(path, "ur", units="m")
