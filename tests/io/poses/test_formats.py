"""Every format against files written out by hand and rotations from textbook formulas alone."""

import re
from math import cos, degrees, radians, sin, sqrt
from pathlib import Path

import numpy as np
import pytest

import handeye_fg as hf
from handeye_fg.errors import InputDataError
from handeye_fg.io.poses import FORMATS
from handeye_fg.options import PoseFormatName

# 120 degrees about (1, 1, 1): x to y to z to x; its quaternion is 1/2 (1, 1, 1, 1) up to the place of w,
# so a second pose, a quarter turn about z, tells that place.
CYCLE = [[0, 0, 1], [1, 0, 0], [0, 1, 0]]
QUARTER = [[0, -1, 0], [1, 0, 0], [0, 0, 1]]
HALF = sqrt(0.5)
POSITIONS = [[0.5, -0.25, 0.125], [0.6, 0.1, 0.3]]
EXPECTED = np.array(
    [
        [[*CYCLE[i], POSITIONS[0][i]] for i in range(3)] + [[0, 0, 0, 1]],
        [[*QUARTER[i], POSITIONS[1][i]] for i in range(3)] + [[0, 0, 0, 1]],
    ]
)
MM = "500,-250,125", "600,100,300"
IMAGES = "a_0.png", "a_1.png"
TIMED = "1700000000.000000000.png", "1700000001.500000000.png"


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


def flat(matrix):
    return [float(v) for row in matrix for v in row]


FIRST, SECOND = (flat(matrix) for matrix in EXPECTED)
FIRST_COLUMNS, SECOND_COLUMNS = (flat(matrix.T) for matrix in EXPECTED)
THIRD = 2 * np.pi / 3 / sqrt(3)  # of the rotation vector of 120 degrees about (1, 1, 1)


def joined(values, sep=" "):
    return sep.join(map(str, values))


# name of the format -> file, its content, names of the images, other options
TEXTS = {
    "csv": (
        "image,x,y,z,qx,qy,qz,qw",
        "a_0.png,0.5,-0.25,0.125,0.5,0.5,0.5,0.5",
        f"a_1.png,0.6,0.1,0.3,0,0,{HALF},{HALF}",
    ),
    "tum": (
        "# timestamp tx ty tz qx qy qz qw",
        "1700000000.0 0.5 -0.25 0.125 0.5 0.5 0.5 0.5",
        f"1700000001.5 0.6 0.1 0.3 0 0 {HALF} {HALF}",
    ),
    "kitti": (joined(FIRST[:12]), joined(SECOND[:12])),
    "euroc": (
        "#timestamp [ns],p_RS_R_x [m],p_RS_R_y [m],p_RS_R_z [m],q_RS_w [],q_RS_x [],q_RS_y [],q_RS_z []",
        "1700000000000000000,0.5,-0.25,0.125,0.5,0.5,0.5,0.5",
        f"1700000001500000000,0.6,0.1,0.3,{HALF},0,0,{HALF}",
    ),
    "eth": (
        "1700000000.0, 0.5, -0.25, 0.125, 0.5, 0.5, 0.5, 0.5",
        f"1700000001.5, 0.6, 0.1, 0.3, 0, 0, {HALF}, {HALF}",
    ),
    "kinhec": (
        "t,q1_meas,base_ee_gt_px,"
        + joined(
            (f"base_ee_meas_{name}" for name in ["px", "py", "pz", "qw", "qx", "qy", "qz"]), ","
        ),
        "1700000000.0,0.1,9,0.5,-0.25,0.125,0.5,0.5,0.5,0.5",
        f"1700000001.5,0.2,9,0.6,0.1,0.3,{HALF},0,0,{HALF}",
    ),
    "ur": (
        "image,X,Y,Z,RX,RY,RZ",
        f"a_0.png,0.5,-0.25,0.125,{THIRD},{THIRD},{THIRD}",
        f"a_1.png,0.6,0.1,0.3,0,0,{np.pi / 2}",
    ),
    "abb": (
        "image,X,Y,Z,Q1,Q2,Q3,Q4",
        f"a_0.png,{MM[0]},0.5,0.5,0.5,0.5",
        f"a_1.png,{MM[1]},{HALF},0,0,{HALF}",
    ),
    "franka": (
        "image," + joined((f"O_T_EE[{i}]" for i in range(16)), ","),
        f"a_0.png,{joined(FIRST_COLUMNS, ',')}",
        f"a_1.png,{joined(SECOND_COLUMNS, ',')}",
    ),
    "matrix": (f"a_0.png {joined(FIRST)}", f"a_1.png {joined(SECOND)}"),
    "moveit": (
        f"- effector_wrt_world: [{joined(FIRST, ', ')}]",
        f"  object_wrt_sensor: [{joined(SECOND, ', ')}]",
        f"- effector_wrt_world: [{joined(SECOND, ', ')}]",
        f"  object_wrt_sensor: [{joined(FIRST, ', ')}]",
    ),
}
ROS2 = """header:
  stamp:
    sec: 1700000000
    nanosec: 0
  frame_id: base_link
pose:
  position:
    x: 0.5
    y: -0.25
    z: 0.125
  orientation:
    x: 0.5
    y: 0.5
    z: 0.5
    w: 0.5
---
header:
  stamp:
    sec: 1700000001
    nanosec: 500000000
  frame_id: base_link
pose:
  position: {x: 0.6, y: 0.1, z: 0.3}
  orientation: {x: 0.0, y: 0.0, z: 0.7071067811865476, w: 0.7071067811865476}
---
"""
ROS1 = """header:
  seq: 17
  stamp:
    secs: 1700000000
    nsecs: 0
  frame_id: "base_link"
child_frame_id: "tool0"
transform:
  translation: {x: 0.5, y: -0.25, z: 0.125}
  rotation: {x: 0.5, y: 0.5, z: 0.5, w: 0.5}
---
header: {seq: 18, stamp: {secs: 1700000001, nsecs: 500000000}, frame_id: "base_link"}
child_frame_id: "tool0"
transform:
  translation: {x: 0.6, y: 0.1, z: 0.3}
  rotation: {x: 0.0, y: 0.0, z: 0.7071067811865476, w: 0.7071067811865476}
"""
ROS2_CSV = f"""1700000000,0,base_link,0.5,-0.25,0.125,0.5,0.5,0.5,0.5
1700000001,500000000,base_link,0.6,0.1,0.3,0.0,0.0,{HALF},{HALF}
"""
ROS2_TRANSFORMS = f"""1700000000,0,base_link,tool0,0.5,-0.25,0.125,0.5,0.5,0.5,0.5
1700000001,500000000,base_link,tool0,0.6,0.1,0.3,0.0,0.0,{HALF},{HALF}
"""
ROS1_CSV = f"""%time,field.header.seq,field.header.stamp,field.header.frame_id,field.pose.position.x,\
field.pose.position.y,field.pose.position.z,field.pose.orientation.x,field.pose.orientation.y,\
field.pose.orientation.z,field.pose.orientation.w
1700000009000000000,1,1700000000000000000,base_link,0.5,-0.25,0.125,0.5,0.5,0.5,0.5
1700000009000000001,2,1700000001500000000,base_link,0.6,0.1,0.3,0.0,0.0,{HALF},{HALF}
"""
TF_ECHO = """At time 1700000000.000
- Translation: [0.500, -0.250, 0.125]
- Rotation: in Quaternion [0.500, 0.500, 0.500, 0.500]
            in RPY (radian) [1.571, -0.000, 1.571]
            in RPY (degree) [90.000, -0.000, 90.000]
At time 1700000001.500
- Translation: [0.600, 0.100, 0.300]
- Rotation: in Quaternion [0.000, 0.000, 0.707, 0.707]
            in RPY (radian) [0.000, -0.000, 1.571]
            in RPY (degree) [0.000, -0.000, 90.000]
"""
TF2_ECHO = """[INFO] [1700000000.1]: Waiting for transform base_link -> tool0
At time 1700000000.000000000
- Translation: [0.500, -0.250, 0.125]
- Rotation: in Quaternion (xyzw) [0.500, 0.500, 0.500, 0.500]
- Rotation: in RPY (radian) [1.571, -0.000, 1.571]
- Rotation: in RPY (degree) [90.000, -0.000, 90.000]
- Matrix:
  0.000  0.000  1.000  0.500
  1.000  0.000  0.000 -0.250
  0.000  1.000  0.000  0.125
  0.000  0.000  0.000  1.000
At time 1700000001.500000000
- Translation: [0.600, 0.100, 0.300]
- Rotation: in Quaternion (xyzw) [0.000, 0.000, 0.707, 0.707]
- Rotation: in RPY (radian) [0.000, -0.000, 1.571]
- Rotation: in RPY (degree) [0.000, -0.000, 90.000]
"""
JSON = f'{{"a_0.png": {EXPECTED[0].tolist()}, "a_1.png": {EXPECTED[1].tolist()}}}'
JSON_LIST = (
    f'[{{"image": "a_0.png", "matrix": {FIRST}}}, {{"image": "a_1.png", "matrix": {SECOND}}}]'
)
# Files of formats with more than one form.
FORMS = {
    "ros2 echo": ("ros", "poses.yaml", ROS2),
    "rostopic echo": ("ros", "poses.txt", ROS1),
    "ros2 echo --csv": ("ros", "poses.csv", ROS2_CSV),
    "ros2 echo --csv of transforms": ("ros", "poses.csv", ROS2_TRANSFORMS),
    "rostopic echo -p": ("ros", "poses.csv", ROS1_CSV),
    "tf_echo": ("ros", "tf.txt", TF_ECHO),
    "tf2_echo": ("ros", "tf.txt", TF2_ECHO),
    "json": ("matrix", "poses.json", JSON),
    "json list": ("matrix", "poses.json", JSON_LIST),
}


def written(folder: Path, name: str, text: str) -> Path:
    path = folder / name
    path.parent.mkdir(exist_ok=True)
    path.write_text(text, encoding="utf-8")
    return path


def assert_expected(poses, images, atol=1e-15):
    assert poses.names == images
    np.testing.assert_allclose(poses.base_T_gripper, EXPECTED, rtol=0.0, atol=atol)


def images_of(name: PoseFormatName) -> tuple[str, ...]:
    return TIMED if FORMATS[name].key == "time" else IMAGES


@pytest.mark.parametrize("name", TEXTS)
def test_a_file_of_each_format(tmp_path, name):
    path = written(tmp_path, "poses.txt", "\n".join(TEXTS[name]))
    how = "order" if FORMATS[name].key == "none" else "auto"
    images = images_of(name)
    assert_expected(hf.read_poses(path, name, images=images, pair_by=how), images)


@pytest.mark.parametrize("name", sorted(set(TEXTS) - {"ur"}))
def test_files_that_tell_their_format_are_recognised(tmp_path, name):
    path = written(tmp_path, "poses.txt", "\n".join(TEXTS[name]))
    how = "order" if FORMATS[name].key == "none" else "auto"
    images = images_of(name)
    assert_expected(hf.read_poses(path, images=images, pair_by=how), images)


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("recognised", [True, False])
def test_other_forms_of_a_format(tmp_path, form, recognised):
    name, file, text = FORMS[form]
    path = written(tmp_path, file, text)
    images = images_of(name)
    poses = hf.read_poses(path, "auto" if recognised else name, images=images)
    assert_expected(poses, images, 1e-15 if "tf" not in form else 1e-15 + 1e-12)


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


@pytest.mark.parametrize(
    ("delimiter", "decimal"),
    [(",", "."), *((delimiter, sign) for delimiter in ";\t |" for sign in ".,")],
)
@pytest.mark.parametrize("line_end", ["\n", "\r\n"])
@pytest.mark.parametrize("mark", ["", "\ufeff"])
def test_tables_as_programs_and_spreadsheets_write_them(
    tmp_path, delimiter, decimal, line_end, mark
):
    lines = [line.replace(",", delimiter) for line in TEXTS["csv"]]
    body = line_end.join(["# exported", *lines[:2], "", f"# {lines[1]}", lines[2], ""])
    body = re.sub(r"\b0\.(?=\d)", f"0{decimal}", body)
    path = written(tmp_path, "poses.csv", mark + body)
    assert_expected(hf.read_poses(path), IMAGES)
