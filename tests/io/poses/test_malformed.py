"""Damaged files of every format: an error that names the file, or poses; nothing else, and soon."""

import io
import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import handeye_fg as hf
from handeye_fg.errors import InputDataError
from handeye_fg.frames import exp
from handeye_fg.io.poses import FORMATS, open_poses, reader, write_poses
from handeye_fg.options import PoseFileOptions
from handeye_fg.types import RobotPoses

TIMED = tuple(f"{1700000000 + i}.5.png" for i in range(3))
TWISTS = [[0.1, -0.2, 0.3, 1.0, 2.0, 3.0], [2.0, 1.0, 0.5, -1.0, 0.0, 9.0], [0, 0, 1, 0, 0, 1]]
POSES = RobotPoses(names=TIMED, base_T_gripper=exp(np.array(TWISTS, dtype=float)))
SUFFIXES = {"ros": (".yaml", ".csv"), "matrix": (".txt", ".npy", ".json"), "moveit": (".yaml",)}
TF_ECHO = "At time 1.5\n- Translation: [0.5, 0.1, 0.2]\n- Rotation: in Quaternion [0, 0, 0, 1]\n"

# As controllers print them.
NOTATIONS = {
    "ur": "a.png p[0.5, 0.1, 0.2, 0.1, 2.2, -0.3]\nb.png p[0.4, 0.1, 0.3, 0.2, 2.1, 0.3]\n",
    "kuka": "a.png {X 500.0, Y 10.0, Z 300.0, A 170.0, B 1.5, C -179.0, S 6, T 50}\n",
    "abb": "a.png [[500.0,10.0,300.0],[0.0,1.0,0.0,0.0],[0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]]\n",
}


def whole_files(folder: Path) -> list[tuple[str, str, bytes]]:
    """Format, suffix and content of a good file in each form; of folders that of a file in them."""
    files = [("ros", ".txt", TF_ECHO.encode())]
    files += [(name, ".txt", text.encode()) for name, text in NOTATIONS.items()]
    for name, entry in FORMATS.items():
        for suffix in SUFFIXES.get(name, (".txt",)):
            path = write_poses(POSES, folder / f"{name}{suffix}", PoseFileOptions(format=name))
            if entry.container == "index":
                files.append((name, path.suffix, path.read_bytes()))
                path = folder / f"{name}_poses"
            if path.is_dir():
                path = min(path.iterdir())
            files.append((name, path.suffix, path.read_bytes()))
    return files


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    return whole_files(tmp_path_factory.mktemp("whole"))


TOKENS = [
    *(
        "nan",
        "inf",
        "-inf",
        "1e999",
        "1e-999",
        "1e308",
        "9" * 400,
        "1_0",
        "0x1F",
        "1,5",
        "\uff11",
        "-",
    ),
    *(
        "\0",
        "\n",
        "\r",
        "\t",
        " ",
        ",",
        ";",
        '"',
        "'",
        "#",
        "%",
        "é",
        "\ufeff",
        "\u2028",
        "a",
        "..",
        "/",
    ),
    *(
        "[",
        "]",
        "{",
        "}",
        "[" * 200,
        "{a: " * 60,
        "- ",
        "---\n",
        ": ",
        "&a ",
        "*a",
        "!!python/x ",
        "<<: ",
    ),
    *(
        "0",
        "1",
        "-1",
        "2",
        "null",
        "true",
        "~",
        "x",
        "image",
        "time",
        "Translation: [",
        "Quaternion [",
    ),
]
edit = st.tuples(
    st.sampled_from(["insert", "replace", "cut", "double", "number", "bytes"]),
    st.floats(0.0, 1.0),
    st.integers(1, 40),
    st.sampled_from(TOKENS),
)


def damaged(data: bytes, edits: list[tuple[str, float, int, str]]) -> bytes:
    for kind, where, length, token in edits:
        start = int(where * len(data))
        end, new = start + length, token.encode()
        if kind == "number":  # a whole number becomes something else
            inside = [
                i for i, byte in enumerate(data[start:], start) if chr(byte) in "0123456789.-"
            ]
            start = inside[0] if inside else start
            end = start
            while end < len(data) and chr(data[end]) in "0123456789.-e":
                end += 1
        middle = {
            "insert": new + data[start:end],
            "cut": b"",
            "double": data[start:end] * 2,
            "bytes": bytes([length * 6, 255 - length]),
        }.get(kind, new)
        data = data[:start] + middle + data[end:]
    return data


@settings(
    max_examples=2000, deadline=20_000, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(
    which=st.integers(0, 10**6),
    edits=st.lists(edit, min_size=1, max_size=4),
    named=st.booleans(),
    how=st.sampled_from(["auto", "order", "number", "time"]),
    images=st.booleans(),
)
def test_damaged_files_give_poses_or_one_clean_error(
    tmp_path, whole, which, edits, named, how, images
):
    name, suffix, content = whole[which % len(whole)]
    path = tmp_path / f"poses{suffix}"
    path.write_bytes(damaged(content, edits))
    options = PoseFileOptions(format=name if named else "auto", pair_by=how)
    try:
        poses = open_poses(path, options, TIMED if images else None).poses()
    except InputDataError as error:
        text = str(error)
        assert str(path) in text
        assert "\n" not in text
        assert len(text) < 2000
    else:
        rotations = poses.base_T_gripper[:, :3, :3]
        assert np.isfinite(poses.base_T_gripper).all()
        np.testing.assert_allclose(
            rotations @ np.swapaxes(rotations, 1, 2), [np.eye(3)] * len(rotations), atol=1e-9
        )
        assert (np.linalg.det(rotations) > 0.0).all()


def array(**header) -> bytes:
    """A .npy file whose header claims other things than its content holds."""
    buffer = io.BytesIO()
    text = {"descr": "<f8", "fortran_order": False, "shape": (2, 4, 4)} | header
    np.lib.format.write_array_header_1_0(buffer, text)
    return buffer.getvalue() + bytes(256)


def header(text: str) -> bytes:
    """A .npy file with another header."""
    return b"\x93NUMPY\x01\x00" + len(text).to_bytes(2, "little") + text.encode()


REST = "y: 0\nz: 0\nqx: 0\nqy: 0\nqz: 0\nqw: 1\n"


@pytest.mark.parametrize(
    ("file", "content", "message"),
    [
        ("p.yaml", "a: &a [1, 2]\nb: [*a, *a]", "aliases are not supported"),
        ("p.yaml", "[" * 3000, "not valid YAML .*nested deeper than 50"),
        ("p.yaml", "x: 1\nx: 2", "a key occurs twice"),
        ("p.yaml", "a: !!python/object/apply:os.system [ls]", "not valid YAML"),
        ("p.yaml", "- 3\n- 4", "column matrix.2 is missing; found 'matrix.0,matrix.1'"),
        ("p.yaml", "x: 0\n" * 0 + "# only a comment", "found .*but wanted poses"),
        ("p.json", "[" * 100_000, "not valid JSON"),
        ("p.json", "{", "not valid JSON"),
        ("p.json", '{"a": 1, "a": 2}', "not valid JSON .*'a' occurs twice"),
        ("p.json", "[[" * 400 + "]]" * 400, "nested too deeply"),
        # Each of these would take minutes if it were looked at by ever longer steps.
        ("p.yaml", "x: 1" + ":1" * 400_000, "not valid YAML .*a value of 800001 characters"),
        ("p.csv", f"image,x\na,{'9' * 10**6}x\nb,1,2", "line 3: found 3 fields"),
        ("p.csv", f"image,x,y,z,qx,qy,qz,qw\na,{'9' * 10**6}x,1,1,1,1,1,1", "line 2, column x"),
        ("p.csv", f"a,{'(' * 10**6},x,y,z\n1,2,3,4,5", "line 1: column .* is missing"),
        ("p.csv", "1" + ",1" * 2000, "line 1: found 2001 fields, but a pose has at most 16"),
        ("p.csv", "1\n" * 1_000_002, "1000002 lines are too many"),
        ("p.txt", "At time 1\nTranslation: [" * 20_000 + " Quaternion", "no transform .* is whole"),
        ("p.json", json.dumps({f"k{i}": i for i in range(2000)}), "2000 different values"),
        ("p.npy", array(shape=(10**6, 4, 4)), "of shape .*1000000, 4, 4"),
        ("p.npy", array(shape=(10**3, 4, 4)), "not an array of numbers"),
        ("p.npy", array(descr="|O"), "object of shape"),
        ("p.npy", array(descr="<c16"), "complex128 of shape"),
        ("p.npy", array(shape=(0, 4, 4)), r"array.shape=\(0, 4, 4\), but must be"),
        ("p.npy", array(shape=(1, 2000)) + bytes(16000), r"array.shape=\(1, 2000\), but must be"),
        ("p.npy", header("-" * 5000 + "1"), "not an array of numbers"),  # RecursionError
        ("p.npy", header("(" * 5000), "not an array of numbers"),  # TokenError
        ("p.npy", header("-" * 9900 + "1"), "not an array of numbers"),  # MemoryError
        ("p.npy", header(" " * 20_000), "not an array of numbers"),
        ("p.yaml", f"x: 0x{'F' * 5000}\n{REST}", "not valid YAML .*a value of 5002 characters"),
        ("p.yaml", f"x: 0x{'F' * 3900}\n{REST}", "column x: 'too large' is not a finite number"),
        ("p.json", f'{{"x": {"9" * 5000}}}', "not valid JSON"),
        ("p.npy", array(shape=(4, 2, 4)), r"array.shape=\(4, 2, 4\), but must be"),
        ("p.npy", b"\x93NUMPY\x01\x00\xff\xff", "not an array of numbers"),
        ("p.txt", b"\xff\xfe1 2", "byte 0 is not UTF-8 text"),
        ("p.txt", "1 2 \0 3", "null byte"),
        ("p.txt", " \n\n", "the file is empty"),
        ("p.txt", "|", "all cells are empty"),
        (
            "p.txt",
            "At time 1\nTranslation: [1, 2]\nQuaternion [0, 0, 0, 1]",
            "transform 1: found 6",
        ),
        ("p.txt", "Translation: [1\nQuaternion [0, 0, 0, 1", "no transform .* is whole"),
    ],
)
def test_files_that_hold_no_poses(tmp_path, file, content, message):
    path = tmp_path / file
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    with pytest.raises(InputDataError, match=f"^poses file {path}.*({message})") as caught:
        hf.read_poses(path)
    assert "\n" not in str(caught.value)


ROTATION = "1 0 0 {} 0 1 0 {} 0 0 1 {} 0 0 0 1"
CONTROLLER = "image,x,y,z,{}\nc.png,500,0,0,"


@pytest.mark.parametrize(
    ("content", "known", "message"),
    [
        ("a.png 2 0 0 1 0 2 0 2 0 0 2 3 0 0 0 1", {}, "line 1: the rotation is not orthonormal"),
        ("a.png -1 0 0 1 0 1 0 2 0 0 1 3 0 0 0 1", {}, "line 1: the determinant .* mirror image"),
        (
            "a.png 1 0 0 0 0 1 0 0 0 0 1 0 1 2 3 1",
            {"format": "matrix"},
            r"last row is \[1.0, 2.0, 3.0, 1.0\].*give --pose-format franka",
        ),
        (
            "a.png 1 0 0 1 0 1 0 2 0 0 1 3 0 0 0 1",
            {"format": "franka"},
            r"last row is \[1.0, 2.0, 3.0, 1.0\].*give --pose-format matrix",
        ),
        (
            "image,x,y,z,qw,qx,qy,qz\na.png,1,2,3,1,1,0,0",
            {},
            "line 2, columns qx,qy,qz,qw: the quaternion's norm is 1.41421",
        ),
        (f"{CONTROLLER.format('w,p,r')}1e9,0,0", {}, "line 2, columns w,p,r: .* is no angle"),
        (
            f"{CONTROLLER.format('w,p,r')}9,0,0".replace("500", "1e12"),
            {},
            "line 2: .* is no position",
        ),
        (
            f"{CONTROLLER.format('w,p,r')}9,0,0".replace("500", "1e300"),
            {},
            "line 2: .* is no position",
        ),
        (f"{CONTROLLER.format('w,p,r')}9,0", {}, "line 2, column r: '' is not a finite number"),
        (
            "# timestamp tx ty tz qx qy qz qw\n1e999 0 0 0 0 0 0 1",
            {"format": "tum"},
            "line 2: '1e999' is no time",
        ),
        ("0 0 0 0 0 0\n" * 2, {"format": "tum"}, "found 6 columns, but TUM trajectory has timest"),
        (
            f"{CONTROLLER.format('rx,ry,rz')}9,0,0",
            {"format": "ur", "rotation": "xyzw"},
            "rotation xyzw has 4 numbers, but ur has 3",
        ),
        (f"{CONTROLLER.format('w,p,r')}9,0,0", {"units": "cm"}, "^options .*units"),
        (
            f"{CONTROLLER.format('w,p,r')}9,0,0",
            {"format": "fanuk"},
            "format is 'fanuk', but must be one of auto, csv",
        ),
    ],
)
def test_rows_that_are_no_poses(tmp_path, content, known, message):
    path = tmp_path / "poses.txt"
    path.write_text(content, encoding="utf-8")
    with pytest.raises(InputDataError, match=message):
        hf.read_poses(path, **known)


def test_a_folder_of_other_things(tmp_path, monkeypatch):
    with pytest.raises(InputDataError, match="0 files named"):
        hf.read_poses(tmp_path)
    (tmp_path / "a.txt").write_text("1 0 0 1 0 1 0 2 0 0 1 3 0 0 0 1")
    (tmp_path / "b.txt").write_text("1 0 0 1 0 1 0 2 0 0 1 3")
    with pytest.raises(InputDataError, match=r"b\.txt: has other content than .*a\.txt"):
        hf.read_poses(tmp_path)
    (tmp_path / "b.txt").write_text("1 0 0 1 0 1 0 2 0 0 1 3\n" * 2)
    with pytest.raises(InputDataError, match=r"b\.txt: holds 2 poses"):
        hf.read_poses(tmp_path)
    monkeypatch.setattr(reader, "_MOST_FILES", 1)
    with pytest.raises(InputDataError, match=r"2 files named .*, at most 1;"):
        hf.read_poses(tmp_path)


def test_files_that_are_too_large_are_refused_unread(tmp_path):
    path = tmp_path / "poses.csv"
    with path.open("wb") as file:
        file.truncate(10**9)  # sparse
    with pytest.raises(InputDataError, match="1000000000 bytes are too many"):
        hf.read_poses(path)
    path.write_text("a: 1\n" * 1_200_000)
    with pytest.raises(InputDataError, match="characters of YAML are too many"):
        hf.read_poses(path)
