import os
import stat
from pathlib import Path

import pytest

from handeye_fg.errors import InputDataError
from handeye_fg.io import files
from handeye_fg.io.files import read_text, write_atomic


def test_text_and_bytes_arrive_unchanged_in_new_folders(tmp_path: Path) -> None:
    path = tmp_path / "a" / "b" / "file"
    assert write_atomic(path, "línea\r\n") == path
    assert path.read_bytes() == "línea\r\n".encode()
    write_atomic(path, b"\x00\xff")
    assert path.read_bytes() == b"\x00\xff"
    assert [entry.name for entry in path.parent.iterdir()] == ["file"]


def test_the_usual_file_mode_applies(tmp_path: Path) -> None:
    plain = tmp_path / "plain"
    plain.write_text("")
    written = write_atomic(tmp_path / "written", "")
    assert stat.S_IMODE(written.stat().st_mode) == stat.S_IMODE(plain.stat().st_mode)


def test_names_of_files_that_are_not_unicode_can_be_written(tmp_path: Path) -> None:
    name = os.fsdecode(b"frame_\xff.jpg")
    assert write_atomic(tmp_path / "a", name).read_text("utf-8") == r"frame_\udcff.jpg"


def test_a_failed_write_leaves_the_old_file_and_no_part(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = write_atomic(tmp_path / "a", "old")

    def full(_descriptor: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(InputDataError, match=r"a: cannot be written \(No space left on device\)"):
        write_atomic(path, "new")
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_an_interrupted_write_leaves_no_part(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupt(_descriptor: int) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(os, "fsync", interrupt)
    with pytest.raises(KeyboardInterrupt):
        write_atomic(tmp_path / "a", "new")
    assert list(tmp_path.iterdir()) == []


def test_a_file_in_the_folder_s_place_is_an_error(tmp_path: Path) -> None:
    (tmp_path / "out").write_text("")
    with pytest.raises(InputDataError, match=r"result\.json: cannot be written .*output folder"):
        write_atomic(tmp_path / "out" / "result.json", "new")
    with (
        pytest.raises(
            InputDataError, match=r"out: cannot be written \(.+\); choose another output"
        ),
        files.sole_use(tmp_path / "out"),
    ):
        pass


def test_reading_drops_the_byte_order_mark_and_carriage_returns(tmp_path: Path) -> None:
    path = tmp_path / "a"
    path.write_bytes(b"\xef\xbb\xbfx\r\ny\rz\n")
    assert read_text(path, "file") == "x\ny\nz\n"


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "the file is empty"),
        (b" \n\t\r\n", "the file is empty"),
        (b"abc\xff", "byte 3 is not UTF-8"),
        (b"\x89PNG\r\n", "byte 0 is not UTF-8"),
        (b"ab\x00c", "character 2 is a null byte"),
    ],
)
def test_what_is_no_text_is_refused(tmp_path: Path, content: bytes, message: str) -> None:
    path = tmp_path / "a.csv"
    path.write_bytes(content)
    with pytest.raises(InputDataError, match=f"^poses file .*a.csv: .*{message}"):
        read_text(path, "poses file")


def test_what_is_no_file_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputDataError, match=r"^poses file .*none\.csv: no such file"):
        read_text(tmp_path / "none.csv", "poses file")
    with pytest.raises(InputDataError, match=r"^poses file .*: cannot be read \(.*directory"):
        read_text(tmp_path, "poses file")
    with pytest.raises(InputDataError, match=r"^poses file .*: cannot be read \(.*null"):
        read_text(tmp_path / "a\0b", "poses file")


def test_an_empty_file_may_be_allowed(tmp_path: Path) -> None:
    path = tmp_path / "a"
    path.write_bytes(b"")
    assert read_text(path, "file", may_be_empty=True) == ""


def test_a_file_that_is_too_large_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(files, "_LARGEST_FILE", 8)
    path = tmp_path / "a.json"
    path.write_bytes(b"12345678")
    assert read_text(path, "file") == "12345678"
    path.write_bytes(b"123456789")
    with pytest.raises(InputDataError, match=r"^file .*a\.json: more than 8 bytes are too many"):
        read_text(path, "file")
