"""Whole batches: what one data set does to another, what is kept, and where it runs."""

import csv
import json
import os
import shutil
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import fsspec
import numpy as np
import psutil
import pytest
from distributed import LocalCluster

import handeye_fg as hf
from handeye_fg import Batch, Comparison, Difference, InputDataError, Row, cli
from handeye_fg.batching import run
from handeye_fg.batching.run import batch
from handeye_fg.batching.task import Job
from handeye_fg.commands.batch import exit_code
from handeye_fg.frames import exp

Sets = Callable[..., Path]

# Imported by each calibration's process at its start: data sets of some names end it as no input of
# ours is known to.
KILLER = """
import json, os, signal
from pathlib import Path
loads, signals = json.loads, {"segfault": signal.SIGSEGV, "out of memory": signal.SIGKILL}
def watched(text, **rest):
    order = loads(text, **rest)
    if isinstance(order, dict) and "outcome" in order:
        name = Path(order["output"]).name
        if name in signals:
            os.kill(os.getpid(), signals[name])
        if name == "exits":
            print("half a", flush=True)
            os._exit(7)
    return order
json.loads = watched
"""


@pytest.fixture
def killer(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "killer").mkdir()
    (tmp_path / "killer" / "sitecustomize.py").write_text(KILLER, encoding="utf-8")
    paths = [str(tmp_path / "killer"), *filter(None, [os.environ.get("PYTHONPATH")])]
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(paths))


def messages(outcome: hf.Batch) -> dict[str, str]:
    return {row.name: row.message for row in outcome.rows if row.status == "failed"}


@pytest.mark.slow
@pytest.mark.usefixtures("killer")
def test_no_data_set_harms_another(sets: Sets, tmp_path: Path) -> None:
    names = {"good & sound": "first", "flat": "flat", "garbled": "second"}
    names |= dict.fromkeys(("segfault", "out of memory", "exits"), "second")
    folder, out = sets(**names), tmp_path / "out"
    (folder / "garbled" / "poses.csv").write_text(
        "name,<script>alert(1)</script>\n1,2\n", encoding="utf-8"
    )
    (folder / "empty").mkdir()
    outcome = batch(folder, out, jobs=2)

    # 1. Each has what it would have alone.
    status = {row.name: row.status for row in outcome.rows}
    failures = ["empty", "exits", "garbled", "out of memory", "segfault"]
    assert status == {
        "good & sound": "ok",
        "flat": "partial",
        **dict.fromkeys(failures, "failed"),
    }
    assert [row.name for row in outcome.rows] == sorted(status)
    alone = hf.refine(folder / "good & sound" / "model", folder / "good & sound" / "poses.csv")
    np.testing.assert_array_equal(hf.load_result(out / "good & sound").matrix, alone.matrix)

    # 2. Each failure says what happened.
    said = messages(outcome)
    assert "empty/images" in said["empty"]
    assert "poses file" in said["garbled"]
    assert "Segmentation fault" in said["segfault"]
    assert "memory" in said["out of memory"]
    assert "code 7" in said["exits"]
    assert "half a" in said["exits"]
    assert (out / "exits" / "log.txt").read_text(encoding="utf-8") == "half a\n"
    assert "Fatal Python error: Segmentation fault" in (out / "segfault" / "log.txt").read_text()
    assert not (out / "good & sound" / "log.txt").exists()

    # 3. The summaries say the same.
    with (out / "summary.csv").open(encoding="utf-8", newline="") as file:
        rows = {row["name"]: row for row in csv.DictReader(file)}
    assert {name: row["status"] for name, row in rows.items()} == status
    assert float(rows["good & sound"]["x_m"]) == alone.matrix[0, 3]
    assert rows["flat"]["metres_per_world_unit"] != ""
    assert rows["garbled"]["x_m"] == ""
    assert rows["garbled"]["message"] == said["garbled"]
    page = (out / "summary.html").read_text(encoding="utf-8")
    assert "good &amp; sound" in page
    assert "good%20%26%20sound/report.html" in page
    assert "<script" not in page
    assert "http" not in page.replace("http-equiv", "")

    # 4. What is done is kept, what failed is done again.
    for name in failures[:2] + failures[3:]:
        shutil.rmtree(folder / name)
    again = batch(folder, out, jobs=2)
    assert {row.name: (row.status, row.kept) for row in again.rows} == {
        "good & sound": ("ok", True),
        "flat": ("partial", True),
        "garbled": ("failed", False),
    }
    files = [path.name for path in out.iterdir() if not path.is_dir()]
    assert sorted(files) == ["summary.csv", "summary.html"]


def program(*arguments: str | Path, threads: str = "1") -> "subprocess.Popen[str]":
    return subprocess.Popen(
        [sys.executable, "-m", "handeye_fg", *map(str, arguments)],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        env={**os.environ, "OMP_NUM_THREADS": threads},
    )


def wait_until(condition: Callable[[], object], seconds: float = 60.0) -> None:
    until = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < until
        time.sleep(0.05)


@pytest.mark.slow
def test_killed_and_begun_again(sets: Sets, tmp_path: Path) -> None:
    folder, out = sets(a="first", b="second", c="third"), tmp_path / "out"
    killed = program("batch", folder, "--output", out, "--jobs", "1")
    wait_until((out / "a" / "batch.json").exists)
    (child,) = psutil.Process(killed.pid).children() or [None]
    killed.kill()
    killed.communicate()
    assert killed.returncode == -signal.SIGKILL
    if child is not None:  # the calibration that was at work ends with the batch
        wait_until(lambda: not child.is_running() or child.status() == psutil.STATUS_ZOMBIE)
    done = {path.parent.name: path.read_bytes() for path in out.glob("*/batch.json")}
    assert "a" in done
    assert len(done) < 3

    outcome = batch(folder, out, jobs=2)
    assert {row.name for row in outcome.rows if row.kept} == set(done)
    assert {row.status for row in outcome.rows} == {"ok"}
    for name, record in done.items():
        assert (out / name / "batch.json").read_bytes() == record
    for name in "abc":
        alone = hf.refine(folder / name / "model", folder / name / "poses.csv")
        np.testing.assert_array_equal(hf.load_result(out / name).matrix, alone.matrix)


def test_a_data_set_that_hangs_is_ended(made: Path, tmp_path: Path) -> None:
    model = str(made / "first" / "model")
    os.mkfifo(tmp_path / "poses.csv")
    data = hf.DataSet(name="hangs", model=model, poses=str(tmp_path / "poses.csv"))
    (row,) = batch([data], tmp_path / "out", timeout_s=3.0).rows
    assert row.status == "failed"
    assert "not done after 3 s" in row.message
    assert 3.0 <= row.seconds < 6.0


def test_interrupt_ends_everything_at_once(made: Path, tmp_path: Path) -> None:
    folder = tmp_path / "sets"
    for name in ("one", "two"):
        (folder / name).mkdir(parents=True)
        (folder / name / "model").symlink_to(made / "first" / "model")
        os.mkfifo(folder / name / "poses.csv")
    process = program("batch", folder, "--output", tmp_path / "out", "--jobs", "2")
    children: list[psutil.Process] = []

    def both_at_work() -> bool:
        children[:] = psutil.Process(process.pid).children()
        return len(children) == 2

    wait_until(both_at_work)
    since = time.monotonic()
    process.send_signal(signal.SIGINT)
    assert process.stdout is not None
    lines = []
    while "Interrupted.\n" not in lines:
        lines.append(process.stdout.readline())
    assert time.monotonic() - since < 2.0
    assert not any(child.is_running() for child in children)
    rest, _ = process.communicate(timeout=20)
    assert process.returncode == 130
    assert "Traceback" not in "".join(lines) + rest


@pytest.fixture
def cluster() -> Iterator[LocalCluster]:
    """A scheduler and two workers that listen on loopback, as others would start them."""
    with LocalCluster(
        n_workers=2,
        threads_per_worker=1,
        processes=False,
        protocol="tcp://",
        host="127.0.0.1",
        dashboard_address="127.0.0.1:0",
        worker_dashboard_address="127.0.0.1:0",
        scheduler_kwargs={"dashboard": False},
    ) as cluster:
        yield cluster


@pytest.mark.slow
def test_on_a_cluster_with_data_in_a_store(
    cluster: LocalCluster, made: Path, tmp_path: Path
) -> None:
    """Workers and the test share the store in memory, as machines share a bucket."""
    store = fsspec.filesystem("memory")
    store.store.clear()
    for name in ("first", "second"):
        store.put(str(made / name), f"/fleet/{name}", recursive=True)
    manifest = tmp_path / "fleet.csv"
    rows = [f"{n},memory://fleet/{n}/model,memory://fleet/{n}/poses.csv" for n in made_names()]
    manifest.write_text("\n".join(["name,model,poses", *rows]) + "\n", encoding="utf-8")
    address = cluster.scheduler_address
    assert address.startswith("tcp://127.0.0.1:")
    outcome = batch(manifest, "memory://nightly", scheduler=address)
    assert [row.status for row in outcome.rows] == ["ok", "ok", "failed"]
    assert "memory://fleet/missing" in outcome.rows[2].message
    for name in ("first", "second"):
        document = json.loads(store.cat(f"/nightly/{name}/result.json"))
        alone = hf.refine(made / name / "model", made / name / "poses.csv")
        assert document["calibration"]["matrix"] == alone.matrix.tolist()
        assert store.exists(f"/nightly/{name}/report.html")
    assert store.cat("/nightly/summary.csv").count(b"\n") == 4
    again = batch(manifest, "memory://nightly", scheduler=address)
    assert [row.kept for row in again.rows] == [True, True, False]
    store.store.clear()


def made_names() -> tuple[str, ...]:
    return ("first", "second", "missing")


def test_a_scheduler_that_is_not_there(
    made: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(run, "_CONNECT_S", 0.5)
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        address = f"tcp://127.0.0.1:{free.getsockname()[1]}"
        with pytest.raises(InputDataError, match="does not answer"):
            batch(made, tmp_path / "out", scheduler=address)


def test_workers_of_this_process_listen_on_loopback_only() -> None:
    with run._client(None, 2):
        listening = [
            connection.laddr.ip
            for connection in psutil.Process().net_connections()
            if connection.status == psutil.CONN_LISTEN
        ]
    assert set(listening) <= {"127.0.0.1"}


def job(name: str) -> Job:
    return Job(
        data=hf.DataSet(name=name, model="m", poses="p"),
        output="out",
        sign="",
        options=hf.Options(),
        threads=1,
        timeout_s=1.0,
        significance=0.01,
    )


@pytest.mark.parametrize(("most", "bound"), [(None, 2 * 2 + 1), (2, 2)])
def test_few_jobs_wait_at_the_scheduler(
    monkeypatch: pytest.MonkeyPatch, most: int | None, bound: int
) -> None:
    """However many data sets there are: what is handed over and not done is bounded."""
    row = Row(name="", status="ok", message="", kept=False, seconds=0.0, worker="")
    monkeypatch.setattr(run, "run_data_set", lambda job, _wanted: replace(row, name=job.data.name))
    taken = 0

    def todo() -> Iterator[Job]:
        nonlocal taken
        for k in range(60):
            taken += 1
            yield job(f"{k}")

    names, ahead = set(), []
    with run._client(None, 2) as client:
        for found in run._rows(client, todo(), most):
            ahead.append(taken - len(names))
            names.add(found.name)
    assert names == {f"{k}" for k in range(60)}
    assert max(ahead) == bound


def test_what_the_cluster_cannot_do_fails_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    row = Row(name="", status="ok", message="", kept=False, seconds=0.0, worker="")

    def calibrated(job: Job, _wanted: Callable[[], bool]) -> Row:
        if job.data.name == "b":
            raise RuntimeError("the worker is of another version")
        return replace(row, name=job.data.name)

    monkeypatch.setattr(run, "run_data_set", calibrated)
    with run._client(None, 1) as client:
        rows = {row.name: row for row in run._rows(client, map(job, "abc"), None)}
    assert [rows[name].status for name in "abc"] == ["ok", "failed", "ok"]
    assert "(the worker is of another version)" in rows["b"].message


@pytest.mark.slow
def test_drift_against_an_earlier_batch(sets: Sets, tmp_path: Path) -> None:
    folder, out, earlier = sets(a="first", b="second"), tmp_path / "out", tmp_path / "earlier"
    batch(folder, out, jobs=2)
    first, second = hf.load_result(out / "a"), hf.load_result(out / "b")
    replace(first, matrix=first.matrix @ exp(np.array([0, 0, 0.01, 0, 0, 0.002]))).save(
        earlier / "a"
    )
    second.save(earlier / "b")
    code = cli.main(["batch", str(folder), "--output", str(out), "--reference", str(earlier), "-q"])
    assert code == 4
    with (out / "summary.csv").open(encoding="utf-8", newline="") as file:
        a, b = csv.DictReader(file)
    assert (a["kept"], b["kept"]) == ("true", "true")
    assert float(a["drift_rotation_deg"]) == pytest.approx(np.rad2deg(0.01))
    assert float(a["drift_translation_mm"]) == pytest.approx(2.0, rel=1e-3)
    assert a["drifted"] == "true"
    assert float(a["drift_probability"]) < 1e-3
    assert (b["drifted"], float(b["drift_probability"])) == ("false", 1.0)
    page = (out / "summary.html").read_text(encoding="utf-8")
    assert "The calibrations differ: X differs by 0.57 deg and 2 mm" in page

    # A reference that was asked for and cannot be read is a failure of the batch.
    (earlier / "a" / "result.json").write_text("{}", encoding="utf-8")
    assert (
        cli.main(["batch", str(folder), "--output", str(out), "--reference", str(earlier), "-q"])
        == 1
    )
    assert "result file" in (out / "summary.csv").read_text(encoding="utf-8")


def test_exit_codes(made: Path) -> None:
    gone = Difference(camera="", first_T_second=np.eye(4), xi=np.ones(6), probability=1e-9)
    moved = Comparison(differences=(gone,), significance=1e-3, message="It moved.")
    ok = Row(name="a", status="ok", message="", kept=False, seconds=1.0, worker="here")
    drifted = replace(ok, drift=moved)
    partial, failed = replace(ok, status="partial"), replace(ok, status="failed")
    unread = replace(ok, drift_problem="no such file")
    worse = [((ok,), 0), ((ok, partial), 3), ((partial, drifted), 4), ((drifted, failed), 1)]
    for rows, code in [*worse, ((ok, unread), 1)]:
        assert exit_code(Batch(rows=rows)) == code


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--jobs", "0"], "jobs is 0"),
        (["--significance", "2"], "significance is 2.0"),
        (["--timeout", "-1"], "timeout_s is -1.0"),
        (["--reference", "nowhere"], "no such folder"),
        (["--config", "none.toml"], "config file none.toml"),
    ],
)
def test_usage_errors_run_nothing(
    made: Path, tmp_path: Path, arguments: list[str], said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert cli.main(["batch", str(made), "--output", str(tmp_path / "out"), *arguments]) == 2
    assert said in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_the_output_cannot_be_its_own_reference(made: Path, tmp_path: Path) -> None:
    with pytest.raises(InputDataError, match="is the output folder"):
        batch(made, tmp_path / "out", reference=tmp_path / "out")
