"""The program as users start it: interrupted, killed, out of disk, twice at a time."""

import json
import resource
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
import yaml

from handeye_fg.errors import InputDataError
from handeye_fg.io import files
from handeye_fg.io.files import sole_use
from handeye_fg.supervised import _interrupted
from tabletop import TABLETOP, save_halves

N_IMAGES = 5
CONTINUE = "The same command continues where this run ended."


@pytest.fixture(scope="module")
def images(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Some of the set at half its size, beside their camera file."""
    folder = tmp_path_factory.mktemp("images")
    save_halves(folder, N_IMAGES)
    camera = yaml.safe_load((TABLETOP / "camera.yaml").read_text())
    fx, fy, cx, cy = (camera["camera_matrix"]["data"][k] for k in (0, 4, 2, 5))
    # Centres of pixels: (u + 0.5) / 2 - 0.5.
    K = [fx / 2, 0, cx / 2 - 0.25, 0, fy / 2, cy / 2 - 0.25, 0, 0, 1]
    camera |= {
        "image_width": 640,
        "image_height": 480,
        "camera_matrix": {"rows": 3, "cols": 3, "data": K},
    }
    (folder.parent / "camera.yaml").write_text(yaml.safe_dump(camera))
    return folder


def start(
    images: Path, out: Path, *flags: str, before: Callable[[], None] | None = None
) -> "subprocess.Popen[str]":
    command = [
        sys.executable,
        "-m",
        "handeye_fg",
        "calibrate",
        str(images),
        str(TABLETOP / "poses.csv"),
    ]
    command += ["--camera", str(images.parent / "camera.yaml"), "--output", str(out), *flags]
    return subprocess.Popen(
        command,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        preexec_fn=before,  # noqa: PLW1509  # limits of the child
    )


def wait_for(process: "subprocess.Popen[str]", line: str) -> None:
    assert process.stderr is not None
    for printed in process.stderr:
        if printed.startswith(line):
            return
    raise AssertionError(f"{line} did not come")


def ignore_interrupts() -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)


@pytest.mark.e2e
@pytest.mark.parametrize("before", [None, ignore_interrupts])
def test_interrupt_ends_the_program_within_two_seconds(
    images: Path, tmp_path: Path, before: Callable[[], None] | None
) -> None:
    """Also where a shell has put it in the background, with interrupts ignored."""
    process = start(images, tmp_path / "out", before=before)
    wait_for(process, "finding features ...")
    time.sleep(0.3)
    since = time.monotonic()
    process.send_signal(signal.SIGINT)
    _, printed = process.communicate(timeout=30)
    assert time.monotonic() - since < 2.0
    assert process.returncode == 130
    assert [line for line in printed.splitlines() if line][-2:] == ["Interrupted.", CONTINUE]
    assert {path.name for path in (tmp_path / "out").iterdir()} <= {"stages", files.LOCK}


@pytest.mark.e2e
def test_an_interrupt_at_the_start_is_no_failure(images: Path, tmp_path: Path) -> None:
    """As soon as the process that works is there, which then still imports."""
    process = start(images, tmp_path / "out")
    children = Path(f"/proc/{process.pid}/task/{process.pid}/children")
    while process.poll() is None and not children.read_text():
        time.sleep(0.002)
    process.send_signal(signal.SIGINT)
    _, printed = process.communicate(timeout=30)
    assert process.returncode == 130
    assert [line for line in printed.splitlines() if line][-2:] == ["Interrupted.", CONTINUE]
    assert "Traceback" not in printed


@pytest.fixture
def as_before() -> Iterator[None]:
    """Interrupts are handled afterwards as they were."""
    handler = signal.getsignal(signal.SIGINT)
    yield
    signal.signal(signal.SIGINT, handler)


@pytest.mark.usefixtures("as_before")
def test_work_that_does_not_hear_is_killed(capsys: pytest.CaptureFixture[str]) -> None:
    deaf = (
        "import signal, time\n"
        "signal.signal(signal.SIGINT, signal.SIG_IGN)\nprint(flush=True)\ntime.sleep(60)"
    )
    with subprocess.Popen([sys.executable, "-c", deaf], stdout=subprocess.PIPE) as child:
        assert child.stdout is not None
        child.stdout.read(1)
        assert _interrupted(child) == 130
    assert child.returncode == -signal.SIGKILL
    printed = capsys.readouterr().err
    assert [line for line in printed.splitlines() if line][-2:] == ["Interrupted.", CONTINUE]


@pytest.mark.e2e
def test_the_work_ends_with_the_program(images: Path, tmp_path: Path) -> None:
    process = start(images, tmp_path / "out")
    wait_for(process, "finding features ...")
    process.kill()
    process.wait()
    since = time.monotonic()
    with sole_use(tmp_path / "out"):
        assert time.monotonic() - since < 3.0
    process.communicate()


@pytest.mark.e2e
def test_a_full_disk_is_explained_and_continued_from(images: Path, tmp_path: Path) -> None:
    """A limit on the size of files, which ends COLMAP as a full disk does."""

    def limited() -> None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (700_000, resource.RLIM_INFINITY))

    process = start(images, tmp_path / "out", "--sfm.max-features", "1000", before=limited)
    out, printed = process.communicate(timeout=120)
    assert out == ""
    assert process.returncode in {1, 2}, printed
    last = printed.splitlines()[-1]
    assert last.startswith("handeye-fg: error: ")
    assert "disk" in last
    assert "continues" in last
    assert "@" not in printed  # no trace
    assert not (tmp_path / "out" / "result.json").exists()
    process = start(images, tmp_path / "out", "--sfm.max-features", "1000")
    _, printed = process.communicate(timeout=120)
    assert process.returncode in {0, 3}, printed
    assert json.loads((tmp_path / "out" / "result.json").read_text())["sfm"]["n_registered"] == 5


def test_one_run_at_a_time_in_a_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(files, "_WAIT_S", 0.1)
    with sole_use(tmp_path / "out"):
        with (
            pytest.raises(InputDataError, match=r"out: another run is writing there; wait"),
            sole_use(tmp_path / "out"),
        ):
            pass
        with sole_use(tmp_path / "other"):
            pass
    with sole_use(tmp_path / "out"):
        pass


def test_a_killed_process_holds_nothing(tmp_path: Path) -> None:
    hold = (
        "import os, signal, sys\nfrom pathlib import Path\nfrom handeye_fg.io.files import sole_use\n"
        "with sole_use(Path(sys.argv[1])):\n    os.kill(os.getpid(), signal.SIGKILL)\n"
    )
    done = subprocess.run([sys.executable, "-c", hold, str(tmp_path)], check=False)
    assert done.returncode == -signal.SIGKILL
    with sole_use(tmp_path):
        pass
