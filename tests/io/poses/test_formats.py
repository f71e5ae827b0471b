"""Every format against files written out by hand."""

import re

import numpy as np
import pytest

import handeye_fg as hf
from handeye_fg.io.poses import FORMATS
from handeye_fg.options import PoseFormatName
from pose_files import (
    EXPECTED,
    HALF,
    IMAGES,
    MM,
    THIRD,
    TIMED,
    assert_expected,
    flat,
    joined,
    written,
)

FIRST, SECOND = (flat(matrix) for matrix in EXPECTED)
FIRST_COLUMNS, SECOND_COLUMNS = (flat(matrix.T) for matrix in EXPECTED)


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
