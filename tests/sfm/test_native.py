"""Long calls of COLMAP: cancelled, translated, counted."""

import time

import pycolmap
import pytest

from handeye_fg.errors import ReconstructionError
from handeye_fg.sfm.native import run_cancellable, set_verbosity


def test_an_interrupt_cancels_the_call_and_waits_for_it() -> None:
    seen: list[pycolmap.CancellationToken] = []
    ended: list[float] = []

    def call(token: pycolmap.CancellationToken) -> None:
        seen.append(token)
        while not token.is_cancelled:
            time.sleep(0.01)
        ended.append(time.monotonic())
        raise InterruptedError("Operation cancelled")

    def poll() -> None:
        raise KeyboardInterrupt

    since = time.monotonic()
    with pytest.raises(KeyboardInterrupt):
        run_cancellable(call, "a test", poll)
    assert seen[0].is_cancelled
    assert ended[0] - since < 2


def test_the_result_comes_back_after_a_last_count() -> None:
    polls: list[int] = []
    assert run_cancellable(lambda _: 7, "a test", lambda: polls.append(1)) == 7
    assert polls


def test_failures_of_colmap_are_translated_and_bugs_are_not() -> None:
    def fail(error: Exception) -> None:
        raise error

    native = ValueError("[sfm.cc:77] Check failed")
    with pytest.raises(ReconstructionError, match=r"during a test: \[sfm") as caught:
        run_cancellable(lambda _: fail(native), "a test", lambda: None)
    assert caught.value.__cause__ is native
    with pytest.raises(KeyError):
        run_cancellable(lambda _: fail(KeyError("a bug")), "a test", lambda: None)


def test_colmap_is_silent_unless_asked() -> None:
    assert pycolmap.logging.minloglevel == 3
    set_verbosity(verbose=True)
    try:
        assert pycolmap.logging.minloglevel == 0
    finally:
        set_verbosity(verbose=False)
    assert pycolmap.logging.minloglevel == 3
