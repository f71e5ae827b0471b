"""One data set at a worker: what its digest depends on, locks, and folders that are not there."""

import fcntl
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from handeye_fg import DataSet, NoiseOptions, Options, SfmOptions
from handeye_fg.batching.task import Job, _digest, run_data_set


@pytest.fixture
def job(made: Path, tmp_path: Path) -> Job:
    shutil.copytree(made / "first", tmp_path / "set")
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / ".sign").touch()
    places = {"model": str(tmp_path / "set/model"), "poses": str(tmp_path / "set/poses.csv")}
    return Job(
        data=DataSet(name="first", **places),
        output=str(tmp_path / "out"),
        sign=".sign",
        options=Options(),
        threads=1,
        timeout_s=60.0,
        significance=1e-3,
    )


def touched(job: Job, name: str) -> None:
    with Path(job.data.model or "").parent.joinpath(name).open("ab") as file:
        file.write(b"\n")


CHANGES: dict[str, Callable[[Job], Any]] = {
    "the poses": lambda job: touched(job, "poses.csv"),
    "the model": lambda job: touched(job, "model/images.bin"),
}


@pytest.mark.parametrize("change", CHANGES.values(), ids=CHANGES.keys())
def test_the_digest_follows_the_input(job: Job, change: Callable[[Job], Any]) -> None:
    before = _digest(job.data, Options())
    assert _digest(job.data, Options()) == before
    change(job)
    assert _digest(job.data, Options()) != before


def test_the_digest_follows_the_options_but_not_the_threads(job: Job) -> None:
    before = _digest(job.data, Options())
    assert _digest(job.data, Options(sfm=SfmOptions(threads=3))) == before
    assert _digest(job.data, Options(seed=1)) != before
    assert _digest(job.data, Options(noise=NoiseOptions(pixel_px=1.0))) != before


def test_a_data_set_that_another_batch_holds_is_left_to_it(job: Job) -> None:
    folder = Path(job.output) / "first"
    folder.mkdir()
    with (folder / ".lock").open("wb") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        row = run_data_set(replace(job, timeout_s=0.3), lambda: True)
    assert row.status == "failed"
    assert "another batch is writing there" in row.message


def test_a_worker_that_sees_another_folder_says_so(job: Job) -> None:
    row = run_data_set(replace(job, sign=".other"), lambda: True)
    assert "does not see the output folder" in row.message


def test_a_link_cannot_lead_out_of_the_output(job: Job, tmp_path: Path) -> None:
    (tmp_path / "elsewhere").mkdir()
    (Path(job.output) / "first").symlink_to(tmp_path / "elsewhere")
    row = run_data_set(job, lambda: True)
    assert "leads out of the output folder" in row.message
    assert list((tmp_path / "elsewhere").iterdir()) == []


def test_a_data_set_that_nobody_wants_any_more_is_ended(job: Job) -> None:
    row = run_data_set(job, lambda: False)
    assert row.message == "the batch was interrupted"


def test_a_config_that_cannot_be_read_fails_its_data_set_only(job: Job, tmp_path: Path) -> None:
    (tmp_path / "run.toml").write_text("sed = 3\n", encoding="utf-8")
    row = run_data_set(
        replace(job, data=replace(job.data, config=str(tmp_path / "run.toml"))), lambda: True
    )
    assert row.status == "failed"
    assert "'sed'" in row.message or "sed is not an option" in row.message


def test_no_result_of_other_input_is_left(job: Job) -> None:
    stale = Path(job.output) / "first" / "result.json"
    stale.parent.mkdir()
    stale.write_text("{}", encoding="utf-8")
    run_data_set(job, lambda: False)
    assert not stale.exists()
