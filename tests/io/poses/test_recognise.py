"""Files that tell their format are recognised; those that do not are refused with what they may be."""

from dataclasses import replace

import numpy as np
import pytest

import handeye_fg as hf
from handeye_fg.errors import InputDataError
from handeye_fg.io.poses import open_poses

SIX = "500,0,400,{},20,170"
ROWS = [f"a_{i}.png,{SIX.format(10 * i)}" for i in range(4)]


def written(folder, *lines):
    path = folder / "poses.csv"
    path.write_text("\n".join(lines))
    return path


@pytest.mark.parametrize(
    ("lines", "formats"),
    [
        (["image,x,y,z,a,b,c", *ROWS], {"kuka", "mitsubishi"}),
        (["image,X,Y,Z,RX,RY,RZ", *ROWS], {"ur", "yaskawa"}),
        (ROWS, {"ur", "kuka", "fanuc", "yaskawa", "kawasaki", "mitsubishi"}),
        (
            [SIX.format(1), SIX.format(2)],
            {"ur", "kuka", "fanuc", "yaskawa", "kawasaki", "mitsubishi"},
        ),
        (["a.png,1,2,3,0,0,0,1", "b.png,1,2,3,0,0,1,0"], {"csv", "abb"}),
        (["1,2,3,0,0,0,1", "1,2,3,0,0,1,0"], {"csv", "abb"}),
        (
            ["1700000000000000000,1,2,3,0,0,0,1", "1700000000000000001,1,2,3,0,0,0,1"],
            {"eth", "euroc"},
        ),
        (["a.png 1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1"], {"matrix", "franka"}),
    ],
)
def test_what_several_formats_fit_is_refused_with_their_names(tmp_path, lines, formats):
    with pytest.raises(InputDataError, match="fit several formats") as caught:
        hf.read_poses(written(tmp_path, *lines))
    for name in formats:
        assert f"--pose-format {name} (" in str(caught.value)


@pytest.mark.parametrize(
    ("lines", "name"),
    [
        (["image,x,y,z,w,p,r", *ROWS], "fanuc"),
        (["image,x,y,z,O,A,T", *ROWS], "kawasaki"),
        (["name;qw;qx;qy;qz;tx;ty;tz", "a.png;1;0;0;0;1;2;3"], "csv"),
        (["t,x,y,z,q_x,q_y,q_z,q_w", "5.5,1,2,3,0,0,0,1"], "tum"),
        (["image,x,y,z,rotvec_x,rotvec_y,rotvec_z", "a.png,1,2,3,0,0,1"], "visp"),
        (["1.5 1 2 3 0 0 0 1", "2.5 1 2 3 0 0 0 1"], "tum"),
        (["1.5, 1, 2, 3, 0, 0, 0, 1", "2.5, 1, 2, 3, 0, 0, 0, 1"], "eth"),
        (["a.png 0 1 0 0 -1 0 0 0 0 0 1 0 1 2 3 1"], "franka"),
    ],
)
def test_what_tells_its_format_is_recognised(tmp_path, lines, name):
    assert open_poses(written(tmp_path, *lines)).read_as.format == name


def test_named_quaternions_are_read_by_name_in_any_order(tmp_path):
    half = np.sqrt(0.5)
    path = written(tmp_path, "image,qw,qx,qy,qz,x,y,z", f"a.png,{half},0,0,{half},1,2,3")
    matrix = hf.read_poses(path).base_T_gripper[0]
    np.testing.assert_allclose(matrix, [[0, -1, 0, 1], [1, 0, 0, 2], [0, 0, 1, 3], [0, 0, 0, 1]])


@pytest.mark.parametrize(
    ("lines", "message"),
    [
        (
            ["image,x,y,z,w,p,r", "a,0.5,0,0.4,10,20,170"],
            "say which unit .*--units m or --units mm",
        ),
        (["image,x,y,z,q1,q2,q3,q4", "a,0.5,0,0.4,1,0,0,0"], "--units m or --units mm"),
        (
            ["image,x,y,z,w,p,r", *(f"{i},500,0,400,{i},0.2,3.1" for i in range(3))],
            "no angle is above 3.1; say .*--angles deg or --angles rad",
        ),
    ],
)
def test_units_that_do_not_suit_the_numbers_are_asked_for(tmp_path, lines, message):
    path = written(tmp_path, *lines)
    for format_ in ("auto", "abb" if "q1" in lines[0] else "fanuc"):
        with pytest.raises(InputDataError, match=message):
            hf.read_poses(path, format_)
        hf.read_poses(path, format_, units="mm", angles="deg")  # if it is so


def test_units_in_the_header_count(tmp_path):
    for header in ("X [m],Y [m],Z [m]", "x_m,y_m,z_m", "X(m),Y(m),Z(m)"):
        path = written(tmp_path, f"image,{header},Q1,Q2,Q3,Q4", "a,0.5,0,0.4,1,0,0,0")
        np.testing.assert_allclose(hf.read_poses(path).base_T_gripper[0, :3, 3], [0.5, 0, 0.4])


def test_a_contract_file_in_millimetres_says_so(tmp_path):
    path = written(tmp_path, "image,x,y,z,qx,qy,qz,qw", "a.png,500,0,400,0,0,0,1")
    matrix = hf.read_poses(path, units="mm").base_T_gripper[0]
    np.testing.assert_allclose(matrix[:3, 3], [0.5, 0, 0.4])


def test_other_conventions_of_the_same_numbers(tmp_path):
    path = written(tmp_path, "image,x,y,z,qx,qy,qz,qw", "a.png,1,2,3,0,0,0,1")
    file = open_poses(path)
    w_first = file.poses(other(file, rotation="wxyz")).base_T_gripper[0]
    np.testing.assert_allclose(w_first[:3, :3], np.diag([-1.0, -1.0, 1.0]), atol=1e-15)
    inverted = file.poses(other(file, inverted=True)).base_T_gripper[0]
    np.testing.assert_allclose(inverted[:3, 3], [-1, -2, -3])


def other(file, **changes):
    return replace(file.convention, **changes)
