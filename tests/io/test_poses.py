import csv
import io
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from handeye_fg.errors import InputDataError
from handeye_fg.frames import exp, pose
from handeye_fg.io.poses import FORMATS, poses_from_mapping, read_poses

quick = settings(max_examples=60, suppress_health_check=[HealthCheck.function_scoped_fixture])
HEADER = "image,x,y,z,qx,qy,qz,qw"
ROW = "a.png,1,2,3,0,0,0,1"

names = st.text(
    st.characters(codec="utf-8", exclude_characters="\0\r/\\:"), min_size=1, max_size=12
).filter(lambda name: name.strip() != "" and name != "..")
coordinates = st.floats(-1e6, 1e6)
rotations = st.lists(st.floats(-3.0, 3.0), min_size=3, max_size=3)


def written(folder: Path, text: str | bytes) -> Path:
    path = folder / "poses.csv"
    path.write_bytes(text.encode() if isinstance(text, str) else text)
    return path


@quick
@given(
    st.dictionaries(
        names, st.tuples(st.tuples(coordinates, coordinates, coordinates), rotations), min_size=1
    ),
    st.permutations(FORMATS["csv"].columns),
    st.sampled_from(["\n", "\r\n"]),
    st.booleans(),
)
def test_round_trip(
    tmp_path: Path, rows: dict[str, Any], columns: list[str], line_end: str, mark: bool
) -> None:
    buffer = io.StringIO()
    table = csv.DictWriter(buffer, columns, lineterminator=line_end, quoting=csv.QUOTE_ALL)
    table.writeheader()
    for name, (position, vector) in rows.items():
        numbers = [*position, *Rotation.from_rotvec(vector).as_quat()]
        table.writerow(
            dict(zip(FORMATS["csv"].columns, [name, *map(repr, map(float, numbers))], strict=True))
        )
    poses = read_poses(written(tmp_path, ("\ufeff" if mark else "") + buffer.getvalue()))
    assert poses.names == tuple(rows)
    for matrix, (position, vector) in zip(poses.base_T_gripper, rows.values(), strict=True):
        expected = pose(Rotation.from_rotvec(vector).as_matrix(), np.array(position))
        np.testing.assert_allclose(matrix, expected, rtol=1e-15, atol=1e-14)


def test_a_point_moves_as_hamilton_quaternions_say(tmp_path: Path) -> None:
    half = np.sqrt(0.5)  # 90 degrees about z takes x to y
    poses = read_poses(written(tmp_path, f"{HEADER}\na.png,1,2,3,0,0,{half},{half}\n"))
    np.testing.assert_allclose(
        poses.base_T_gripper[0] @ [1.0, 0.0, 0.0, 1.0], [1.0, 3.0, 3.0, 1.0], atol=1e-15
    )


def test_blank_lines_spaces_and_other_columns_are_passed_over(tmp_path: Path) -> None:
    text = f"time, {HEADER}\n\n7, a.png, 1, 2 , 3, 0, 0, 0, 1\n,,,,,,,,\n\n8,b.png,1,2,3,0,0,0,1"
    assert read_poses(written(tmp_path, text)).names == ("a.png", "b.png")


def test_odd_names_pass_unharmed(tmp_path: Path) -> None:
    odd = ["<script>alert(1)</script>.jpg", "NA", "nan", "", "null", "a..b.png", 'q"uote', "é☃.png"]
    odd.remove("")
    rows = "".join(f'"{name.replace(chr(34), 2 * chr(34))}",1,2,3,0,0,0,1\n' for name in odd)
    assert read_poses(written(tmp_path, f"{HEADER}\n{rows}")).names == tuple(odd)


def test_rounded_quaternions_are_normalised(tmp_path: Path) -> None:
    poses = read_poses(written(tmp_path, f"{HEADER}\na.png,0,0,0,0.577,0.577,0.577,0\n"))
    rotation = poses.base_T_gripper[0, :3, :3]
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-15)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "the file is empty"),
        ("\n\nimage,x", "no row after the header"),
        ("# a\n% b", "there are only comments"),
        ("image,x,y,z,qx,qy,qz\na,1,2,3,0,0,0", "line 1: column qw is missing; found 'image,x,y"),
        ("image;x;y;z;qx;qy;qz;qw\n", "no row after the header"),
        ("\n# made by hand\nimage;x;y\na;1;2", "line 3: column z is missing; found 'image,x,y'"),
        (f"{HEADER},x\n{ROW},9", "line 1: column x occurs more than once"),
        (HEADER, "no row after the header"),
        (f"{HEADER}\n{ROW}\n\n{ROW}", "line 4, column image: 'a.png' is already in line 2"),
        (f"{HEADER}\n{ROW}\nb.png,1,nan,3,0,0,0,1", "line 3, column y: 'nan' is not a finite"),
        (f"{HEADER}\nb.png,1,2,-inf,0,0,0,1", "line 2, column z: '-inf' is not a finite"),
        (f"{HEADER}\nb.png,1e999,2,3,0,0,0,1", "line 2, column x: '1e999' is not a finite"),
        (f"{HEADER}\nb.png,1_0,2,3,0,0,0,1", "line 2, column x: '1_0' is not a finite"),
        (f"{HEADER}\nb.png,1,2,3,0,zero,0,1", "line 2, column qy: 'zero' is not a finite"),
        (f"{HEADER}\nb.png,1,2,3,0,0,0", "line 2, column qw: '' is not a finite"),
        (f'{HEADER}\n"a\nb",1,2,3,0,0,0,1\nc,?,2,3,0,0,0,1', r"line 4, column x: '\?' is not"),
        (f"{HEADER}\nb.png,1,2,3,0,0,0,1.01", "line 2, .*qw: the quaternion's norm is 1.01,"),
        (f"{HEADER}\nb.png,1,2,3,0,0,0,0", "line 2, .*qw: the quaternion's norm is 0,"),
        (f"{HEADER}\nb.png,1,2,3,0,0,1e308,1e308", "line 2, .*qw: the quaternion's norm is "),
        (f"{HEADER}\n{ROW},4", "line 2: found 9 fields, but line 1 has 8"),
        (f'{HEADER}\n"{ROW}', "not a table .*close the quotes"),
        (f"{HEADER}\n ,1,2,3,0,0,0,1", "line 2, column image: '' is no image name"),
        (f"{HEADER}\n/a.png,1,2,3,0,0,0,1", "line 2, column image: '/a.png' leads out"),
        (f"{HEADER}\n../a.png,1,2,3,0,0,0,1", r"column image: '\.\./a.png' leads out"),
        (f"{HEADER}\nb\\..\\a.png,1,2,3,0,0,0,1", r"column image: .*a.png' leads out"),
        (f"{HEADER}\nC:\\a.png,1,2,3,0,0,0,1", r"column image: 'C:.*a.png' leads out"),
    ],
)
def test_errors_name_file_line_column_and_value(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(InputDataError, match=f"^poses file .*poses.csv.*{message}") as caught:
        read_poses(written(tmp_path, text))
    assert "\n" not in str(caught.value)


def test_long_cells_are_shortened_in_messages(tmp_path: Path) -> None:
    with pytest.raises(InputDataError) as caught:
        read_poses(written(tmp_path, f"{HEADER}\na,{'z' * 100_000},2,3,0,0,0,1"))
    assert len(str(caught.value)) < 300 + len(str(tmp_path))


@quick
@given(st.one_of(st.binary(max_size=200), st.text(max_size=200).map(str.encode)))
def test_nothing_but_input_data_errors(tmp_path: Path, content: bytes) -> None:
    for text in (content, HEADER.encode() + b"\n" + content):
        with pytest.raises(InputDataError):
            read_poses(written(tmp_path, text))


@quick
@given(
    st.lists(
        st.lists(
            st.sampled_from(["a", "b", "0", "1", "-1e-3", "1e308", "nan", "", '"', " ", "..", "é"]),
            min_size=7,
            max_size=9,
        ),
        max_size=4,
    )
)
def test_tables_of_odd_cells_give_poses_or_input_data_errors(
    tmp_path: Path, rows: list[list[str]]
) -> None:
    try:
        poses = read_poses(written(tmp_path, "\n".join([HEADER, *map(",".join, rows)])))
    except InputDataError:
        return
    assert np.isfinite(poses.base_T_gripper).all()


def test_mapping_gives_poses_in_its_order() -> None:
    matrices = exp(np.array([[0.1, -0.2, 0.3, 1.0, 2.0, 3.0], [2.0, 1.0, 0.5, -1.0, 0.0, 9.0]]))
    poses = poses_from_mapping({"b": matrices[0], "a": matrices[1]})
    assert poses.names == ("b", "a")
    np.testing.assert_allclose(poses.base_T_gripper, matrices, atol=1e-14)


def test_rounded_matrices_are_made_orthonormal() -> None:
    matrix = exp(np.array([0.1, -0.2, 0.3, 1.0, 2.0, 3.0])).round(5)
    rotation = poses_from_mapping({"a": matrix}).base_T_gripper[0, :3, :3]
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-15)
    np.testing.assert_allclose(rotation, matrix[:3, :3], atol=1e-5)


def changed(i: int, j: int, value: float) -> Any:
    matrix = np.eye(4)
    matrix[i, j] = value
    return matrix


@pytest.mark.parametrize(
    ("mapping", "message"),
    [
        ({}, "the mapping is empty"),
        ({7: np.eye(4)}, "7 is no image name"),
        ({"": np.eye(4)}, "'' is no image name"),
        ({"../a": np.eye(4)}, r"'\.\./a' leads out of the image folder"),
        ({"a": np.eye(3)}, r"image 'a': array.shape=\(3, 3\), but must be \(4, 4\)"),
        ({"a": "eye"}, "image 'a': not an array of numbers"),
        ({"a": changed(1, 3, np.nan)}, "image 'a': the value in row 1, column 3 is nan"),
        ({"a": changed(3, 0, 0.5)}, r"image 'a': the last row is \[0.5, 0.0, 0.0, 1.0\]"),
        ({"a": changed(0, 0, 1.001)}, "image 'a': the rotation is not orthonormal .* 0.002"),
        ({"a": changed(0, 0, 1e300)}, "image 'a': the rotation is not orthonormal"),
        ({"a": changed(2, 2, -1.0)}, "image 'a': the determinant of the rotation is -1"),
    ],
)
def test_bad_mappings_are_refused(mapping: Any, message: str) -> None:
    with pytest.raises(InputDataError, match=message):
        poses_from_mapping(mapping)
