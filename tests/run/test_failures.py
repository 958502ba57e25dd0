"""What a run notes of the fabrics that did not finish."""

import json
import logging
import os
from enum import Enum, auto
from pathlib import Path

import pytest

from kinran.run import failures
from kinran.run.failures import Failure, Watch, forget


class Event(Enum):
    """Events with the names that Snakemake gives them."""

    JOB_ERROR = auto()
    JOB_FINISHED = auto()
    JOB_INFO = auto()


def emit(watch: Watch, event: Event, **said: object) -> None:
    record = logging.makeLogRecord({"event": event, **said})
    watch.handle(record)


def failed(watch: Watch, jobid: int, rule: str, log: str) -> None:
    emit(watch, Event.JOB_ERROR, jobid=jobid, rule_name=rule, log=[log] if log else [])


def written(path: str, text: str, time: int) -> str:
    Path(path).parent.mkdir(parents=True, exist_ok=True)
    Path(path).write_text(text)
    os.utime(path, (time, time))
    return path


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def test_the_last_sentence_of_the_log_that_was_written_last() -> None:
    """Jobs of a group are all reported as failed, with the one that failed last."""
    watch = Watch(Path())
    failed(watch, 1, "stack", written("logs/silk/stack.log", "stack: 9 of 9 shards\nkinran stack: is full\n\n", 20))
    failed(watch, 2, "merge", written("logs/silk/merge/00.log", "merged\n", 10))
    failed(watch, 3, "report", "logs/silk/report.log")
    assert watch.failures({"silk": "generated"}) == [
        Failure("silk", "stack", "kinran stack: is full", "logs/silk/stack.log")
    ]


def test_a_job_that_said_nothing() -> None:
    watch = Watch(Path())
    failed(watch, 1, "fit", "logs/silk/fit/slope.0.log")
    (failure,) = watch.failures({"silk": "generated"})
    assert failure.says == "said nothing: it was killed, or never began"


def test_all_fabrics_fall_with_the_mesh_that_they_share() -> None:
    watch = Watch(Path())
    failed(watch, 1, "mesh", written("logs/_meshes/cloth-1/mesh.log", "kinran mesh: has no face\n", 20))
    found = watch.failures({"silk": "cloth-1", "gold": "cloth-1", "robe": "generated"})
    assert [(failure.fabric, failure.stage, failure.says) for failure in found] == [
        ("silk", "mesh", "kinran mesh: has no face"),
        ("gold", "mesh", "kinran mesh: has no face"),
    ]


def test_a_job_that_was_killed_in_the_middle_of_its_work() -> None:
    """What it said last is no reason; where its shell could still tell, that is the sentence that matters."""
    watch = Watch(Path())
    failed(watch, 1, "merge", written("logs/silk/merge/00.log", "group 00: 3 of 8 shards\n", 10))
    failed(
        watch, 2, "fit", written("logs/wool/fit.log", "slope: 3 of 8 tiles\nkinran fit: was killed, most likely\n", 10)
    )
    failed(watch, 3, "need", written("logs/felt/need.log", "Traceback …\nMemoryError\n", 10))
    assert [failure.says for failure in watch.failures(dict.fromkeys(("silk", "wool", "felt"), "generated"))] == [
        "said no error, so it was killed, or Snakemake misses a file; last: group 00: 3 of 8 shards",
        "kinran fit: was killed, most likely",
        "MemoryError",
    ]


def test_what_is_no_failure_of_a_fabric() -> None:
    """A job that a new attempt finished, one that all fabrics share, a row that is wrong, and the chart."""
    watch = Watch(Path())
    failed(watch, 1, "fit", "logs/silk/fit/slope.0.log")
    emit(watch, Event.JOB_FINISHED, job_id=1)
    failed(watch, 2, "charts", "logs/charts.log")
    failed(watch, 3, "left_out", "logs/wrong/left_out.log")
    failed(watch, 4, "chart_kind", "logs/silk/chart/linear.log")
    failed(watch, 5, "stability", "")
    emit(watch, Event.JOB_INFO, jobid=6)
    watch.handle(logging.makeLogRecord({"msg": "no event"}))
    assert watch.failures({"silk": "generated"}) == []
    failed(watch, 1, "fit", "logs/silk/fit/slope.0.log")
    assert [failure.fabric for failure in watch.failures({"silk": "generated"})] == ["silk"]


def test_a_note_is_forgotten_but_not_the_run(tmp_path: Path) -> None:
    """So the note differs from any before it, and the overview that lists the failures is written again."""
    path = tmp_path / "results" / "failures.json"
    forget(tmp_path, {})
    first = path.read_bytes()
    path.write_text(json.dumps({"run": "a.log", "failures": [{"fabric": "silk"}]}))
    forget(tmp_path, {})
    assert json.loads(path.read_bytes()) == {"run": "a.log", "failures": []}
    assert path.read_bytes() != first
    before = path.stat()
    forget(tmp_path, {})
    assert path.stat().st_mtime_ns == before.st_mtime_ns
    forget(Path(), {"wrong": "a.tsv: line 3: is wrong"})
    (noted,) = json.loads(path.read_bytes())["failures"]
    assert noted == {
        "fabric": "wrong",
        "stage": "config",
        "says": "a.tsv: line 3: is wrong",
        "log": "logs/wrong/left_out.log",
    }


def test_a_folder_that_is_only_read_is_no_error(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    (tmp_path / "results").touch()
    forget(tmp_path, {})
    assert "cannot be written to" in caplog.text


def test_the_overview_lists_who_failed_and_who_was_not_run() -> None:
    failures.write_overview(
        "a.log", [Failure("silk", "fit", "is <full>", "logs/silk/fit.log")], ["silk", "wool"], {}, Path()
    )
    page = Path("results/report.html").read_text()
    assert "<td>silk</td><td>fit</td><td>is &lt;full&gt;</td>" in page
    assert "<td>wool</td><td></td><td>did not get to its report in this run</td><td></td>" in page
    assert "2 fabrics, 2 not finished" in page


def test_rules_and_folders_of_a_module_have_other_names() -> None:
    watch = Watch(Path("textiles"))
    failed(watch, 1, "kinran_fit", written("textiles/logs/silk/fit/slope.0.log", "kinran fit: is full\n", 20))
    failed(watch, 2, "kinran_chart_kind", written("textiles/logs/silk/chart/linear.log", "is empty\n", 30))
    failed(watch, 3, "mine", written("logs/silk/mine.log", "is no job of the module\n", 40))
    found = watch.failures({"silk": "generated"})
    assert found == [Failure("silk", "kinran_fit", "kinran fit: is full", "textiles/logs/silk/fit/slope.0.log")]
