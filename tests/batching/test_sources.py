import os
from collections.abc import Iterator
from pathlib import Path

import fsspec
import pytest

from handeye_fg import InputDataError
from handeye_fg.batching import sources


@pytest.fixture
def store() -> Iterator[fsspec.AbstractFileSystem]:
    """A store in memory, empty before and after."""
    system = fsspec.filesystem("memory")
    system.store.clear()
    yield system
    system.store.clear()


def test_a_signature_follows_the_content(tmp_path: Path) -> None:
    (tmp_path / "a" / "sub").mkdir(parents=True)
    (tmp_path / "a" / "sub" / "x.txt").write_text("1", encoding="utf-8")
    before = sources.signature(str(tmp_path / "a"))
    (tmp_path / "a").rename(tmp_path / "b")
    assert sources.signature(str(tmp_path / "b")) == before
    (tmp_path / "b" / "sub" / "x.txt").write_text("2", encoding="utf-8")
    changed = sources.signature(str(tmp_path / "b"))
    assert [name for name, _ in changed] == [name for name, _ in before]
    assert changed != before
    (tmp_path / "b" / "y.txt").touch()
    assert sources.signature(str(tmp_path / "b")) != changed
    assert sources.signature(str(tmp_path / "none")) == [(".", "nothing to read")]


def test_a_pipe_is_not_opened(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "poses.csv")  # to open it would block for ever
    assert sources.signature(str(tmp_path / "poses.csv")) == [(".", "nothing to read")]


def test_a_url_is_fetched_and_put(store: fsspec.AbstractFileSystem, tmp_path: Path) -> None:
    store.pipe({"/in/images/cam0/a.jpg": b"A", "/in/images/b.jpg": b"B", "/in/poses.csv": b"P"})
    images = Path(sources.fetched("memory://in/images", tmp_path))
    assert (images / "cam0" / "a.jpg").read_bytes() == b"A"
    assert (images / "b.jpg").read_bytes() == b"B"
    poses = sources.fetched("memory://in/poses.csv", tmp_path)
    assert Path(poses).read_bytes() == b"P"
    for hidden in ("stages/database.db", ".lock"):
        (images / hidden).parent.mkdir(exist_ok=True)
        (images / hidden).touch()
    sources.put(images, "memory://out/x", "b.jpg", left_out="stages")
    assert sorted(store.find("/out")) == ["/out/x/b.jpg", "/out/x/cam0/a.jpg"]
    assert store.cat("/out/x/cam0/a.jpg") == b"A"
    assert sources.exists("memory://out/x/b.jpg")
    before = sources.signature("memory://in/images")
    assert [name for name, _ in before] == ["b.jpg", "cam0/a.jpg"]
    store.pipe("/in/images/b.jpg", b"longer")
    assert sources.signature("memory://in/images") != before


def test_a_path_is_used_where_it_is(tmp_path: Path) -> None:
    assert sources.fetched("/some/where", tmp_path) == "/some/where"
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("name", ["/in/../../evil", r"/in/..\..\evil"])
def test_a_name_in_a_store_cannot_lead_out(
    name: str, store: fsspec.AbstractFileSystem, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    listing = {name: {"name": name, "size": 1, "type": "file"}}
    monkeypatch.setattr(type(store), "find", lambda *_, **__: listing)
    with pytest.raises(InputDataError, match="leads out"):
        sources.fetched("memory://in", tmp_path / "scratch")


def test_a_url_cannot_lead_out(store: fsspec.AbstractFileSystem, tmp_path: Path) -> None:
    store.pipe("/in/../evil", b"E")
    with pytest.raises(InputDataError, match=r"memory://in/\.\.: names no file or folder"):
        sources.fetched("memory://in/..", tmp_path / "scratch")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("url", ["memory://nothing/here", "nosuchstore://x", "s3://x/y"])
def test_what_cannot_be_fetched_says_why(url: str, tmp_path: Path) -> None:
    with pytest.raises(InputDataError, match=url):
        sources.fetched(url, tmp_path)
