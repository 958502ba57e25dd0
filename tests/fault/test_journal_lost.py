"""A journal that is damaged, cut or lost: no frame is ever replaced, and a repair gives back what can be proven."""

import errno
import hashlib
import json
import os
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from capture_bench import DEVICE, EXPOSURES, Bench, check, small_plan

from kinran.__main__ import main
from kinran.base.files import InputError, write_json
from kinran.capture.bit_rot import verify
from kinran.capture.brackets_taken import read_brackets
from kinran.capture.journal import COPY, JOURNAL, Journal, line, lock, read, split
from kinran.capture.light_dose import light_dose
from kinran.capture.repair import repair, sound_lines
from kinran.capture.sidecar import read_sidecars

PLAN = small_plan()
FRAMES = 16 * len(EXPOSURES)


def flipped(text: bytes, place: int) -> bytes:
    return text[:place] + bytes([text[place] ^ 4]) + text[place + 1 :]


DAMAGES: dict[str, Callable[[bytes], bytes | None]] = {
    "missing": lambda text: None,
    "empty": lambda text: b"",
    "CRLF": lambda text: text.replace(b"\n", b"\r\n"),
    "UTF-16": lambda text: text.decode().encode("utf-16"),
    "UTF-16 without mark, CRLF": lambda text: text.decode().replace("\n", "\r\n").encode("utf-16-be"),
    "UTF-8 with mark": lambda text: b"\xef\xbb\xbf" + text,
    "flipped in the first line": lambda text: flipped(text, 30),
    "flipped in the middle": lambda text: flipped(text, len(text) // 2),
    "flipped in the last line": lambda text: flipped(text, len(text) - 40),
    "a line end in the middle gone": lambda text: b"".join([*split(text)[:9], split(text)[9][:-1], *split(text)[10:]]),
    "ten last lines gone": lambda text: b"".join(split(text)[:-10]),
    "all but two lines gone": lambda text: b"".join(split(text)[:2]),
    "cut in a line far before the end": lambda text: text[: len(text) // 2],
    "an intent gone": lambda text: b"".join(split(text)[:5] + split(text)[6:]),
    "a frame of an old bracket gone": lambda text: b"".join(split(text)[:4] + split(text)[5:]),
    "first half gone": lambda text: b"".join(split(text)[20:]),
    "NULs in the middle": lambda text: text[:4096] + b"\0" * 2000 + text[6096:],
    "all NUL": lambda text: b"\0" * len(text),
}
"""What can happen to a journal."""


@pytest.fixture
def bench(tmp_path: Path) -> Bench:
    """A rig and a camera with an empty card, for a capture named silk."""
    return Bench(tmp_path / "silk")


@pytest.fixture(scope="module")
def taken(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Captures of a whole group, and of half of one."""
    folder = tmp_path_factory.mktemp("taken")
    Bench(folder / "whole").capture(PLAN)
    halfway(Bench(folder / "half"))
    return {name: folder / name for name in ("whole", "half")}


def copied(taken: Path, root: Path, exposures: int) -> Bench:
    """A copy of a capture, with a rig and a camera that have taken so many exposures."""
    shutil.copytree(taken, root)
    bench = Bench(root)
    bench.camera.fired = [f"IMG_{k:05d}.raw" for k in range(1, exposures + 1)]
    bench.firmware.advance(3600)  # what it takes is newer
    return bench


def damage(path: Path, harm: Callable[[bytes], bytes | None]) -> None:
    text = harm(path.read_bytes())
    if text is None:
        path.unlink()
    else:
        path.write_bytes(text)


def contents(root: Path) -> set[str]:
    """Digests of all frames, wherever they are."""
    return {hashlib.sha256(path.read_bytes()).hexdigest() for path in root.rglob("*.raw") if "card" not in path.parts}


def halfway(bench: Bench, exposures: int = 20) -> None:
    """Capture until the host is killed in an exposure."""
    real = bench.camera.expose

    def expose(seconds: float) -> None:
        if len(bench.camera.fired) == exposures:
            raise KeyboardInterrupt
        real(seconds)

    bench.camera.expose = expose  # type: ignore[method-assign]
    with pytest.raises(KeyboardInterrupt):
        bench.capture(PLAN)
    bench.camera.expose = real  # type: ignore[method-assign]


@pytest.mark.parametrize("copy", [True, False], ids=["copy", "no copy"])
@pytest.mark.parametrize("harm", DAMAGES)
def test_a_damaged_journal_is_refused_and_repaired(
    taken: dict[str, Path], tmp_path: Path, harm: str, copy: bool
) -> None:
    """A whole group: the capture refuses, no frame is lost, and after the repair nothing is to be shot."""
    bench = copied(taken["whole"], tmp_path / "silk", FRAMES)
    manifest = bench.capture(PLAN, devices=None)
    before = contents(bench.root)
    journal = bench.root / JOURNAL
    damage(journal, DAMAGES[harm])
    if not copy:
        (bench.root / COPY).unlink()
    with pytest.raises(InputError, match="run `kinran rig repair silk`"):
        bench.capture(PLAN)
    assert len(bench.camera.fired) == FRAMES
    assert contents(bench.root) == before
    assert len(before) == FRAMES

    harmed = journal.read_bytes()
    found = repair(bench.root)
    assert (found.proven, found.frames, found.unproven, found.gone) == (16, FRAMES, {}, [])
    assert found.changed
    if harmed:
        assert (bench.root / found.kept[0]).read_bytes() == harmed
    again = repair(bench.root)
    assert (again.proven, again.changed, again.kept) == (16, False, [])
    assert bench.capture(PLAN) == manifest
    assert len(bench.camera.fired) == FRAMES
    check(bench.root, PLAN, bench.capture(PLAN, devices=None))
    assert verify(bench.root)[1] == []


@pytest.mark.parametrize("harm", DAMAGES)
def test_a_capture_goes_on_after_a_repair(taken: dict[str, Path], tmp_path: Path, harm: str) -> None:
    """Half a group, and no copy yet: what was recorded is not shot again."""
    bench = copied(taken["half"], tmp_path / "silk", 20)
    before = contents(bench.root)
    assert len(before) == 18
    damage(bench.root / JOURNAL, DAMAGES[harm])
    with pytest.raises(InputError, match="run `kinran rig repair silk`"):
        bench.capture(PLAN)
    assert len(bench.camera.fired) == 20
    assert repair(bench.root).proven == 6
    check(bench.root, PLAN, bench.capture(PLAN))
    assert contents(bench.root) >= before
    assert len(bench.camera.fired) <= FRAMES + 2  # the two exposures of the bracket under way


def test_the_journal_of_another_fabric(tmp_path: Path) -> None:
    """Of the same plan, from a rig that did the same: only the bytes of the frames differ."""
    benches = [Bench(tmp_path / name) for name in ("silk", "wool")]
    benches[1].camera.fired = ["IMG_00000.raw"]
    for bench in benches:
        bench.capture(PLAN)
    silk, wool = (bench.root for bench in benches)
    before = contents(silk)
    for name in (JOURNAL, COPY):
        shutil.copy(silk / name, silk / f"{name}.mine")
        shutil.copy(wool / name, silk / name)
    with pytest.raises(InputError, match="run `kinran rig repair silk`"):
        benches[0].capture(PLAN)
    assert contents(silk) == before
    assert repair(silk).proven == 16
    assert read(silk / JOURNAL)[0] == [
        record for record in read(silk / f"{JOURNAL}.mine")[0] if record["t"] not in ("complete", "steady")
    ]
    check(silk, PLAN, benches[0].capture(PLAN))
    assert len(benches[0].camera.fired) == FRAMES


def test_a_lost_journal_of_frames_without_sidecars(bench: Bench) -> None:
    """Nothing proves them: they stay, are listed and shot again, and are nowhere replaced."""
    halfway(bench)
    before = contents(bench.root)
    (bench.root / JOURNAL).unlink()
    for path in (bench.root / "frames").rglob("*.jsonl"):
        path.unlink()
    with pytest.raises(InputError, match="run `kinran rig repair silk`"):
        bench.capture(PLAN)
    found = repair(bench.root)
    assert (found.proven, len(found.unproven)) == (0, 18)
    assert not repair(bench.root).changed
    check(bench.root, PLAN, bench.capture(PLAN))
    assert len(bench.camera.fired) == 20 + FRAMES
    assert contents(bench.root) >= before
    assert len(list((bench.root / "superseded" / "unrecorded").iterdir())) == 18
    assert verify(bench.root)[1] == []
    bench.capture(PLAN, devices=None)


@pytest.mark.parametrize("source", ["copy", "journal"])
def test_damaged_sidecars_are_written_again(bench: Bench, source: str) -> None:
    bench.capture(PLAN)
    sidecars = sorted((bench.root / "frames").rglob("*.jsonl"))
    assert len(sidecars) == 16
    texts = [path.read_bytes() for path in sidecars]
    sidecars[0].write_bytes(texts[0][:-3])
    sidecars[1].unlink()
    if source == "copy":
        (bench.root / JOURNAL).unlink()
    assert repair(bench.root).written == 2
    assert [path.read_bytes() for path in sidecars] == texts
    assert not repair(bench.root).changed
    bench.capture(PLAN, devices=None)


def test_a_flipped_frame_is_shot_again_after_a_repair(bench: Bench) -> None:
    """Its size is right, so that a capture alone does not see it."""
    manifest = bench.capture(PLAN)
    path = bench.root / manifest["shots"][3]["frames"][1]["file"]
    path.write_bytes(flipped(path.read_bytes(), 7))
    count, wrong = verify(bench.root)
    assert count == FRAMES
    assert wrong == [f"{path}: has other bytes than were recorded"]
    found = repair(bench.root)
    assert (found.proven, len(found.unproven)) == (15, 3)
    assert str(path.relative_to(bench.root)) in found.unproven
    assert not repair(bench.root).changed
    check(bench.root, PLAN, bench.capture(PLAN))
    assert len(bench.camera.fired) == FRAMES + 3
    assert verify(bench.root)[1] == []


def test_replaced_and_quarantined_brackets_stay_void(bench: Bench) -> None:
    """Without a journal: the folders say which bracket was replaced, and which frames were put aside."""
    bench.camera.misbehave = ["", "surplus"]
    bench.capture(PLAN)
    other = {"device": "fake", "scene": {"texels": 9}}
    manifest = bench.capture(PLAN, device=other)
    (bench.root / JOURNAL).unlink()
    (bench.root / COPY).unlink()
    found = repair(bench.root)
    assert (found.proven, found.void, found.unproven) == (16, 16, {})
    assert not repair(bench.root).changed
    fired = len(bench.camera.fired)
    assert bench.capture(PLAN, device=other) == manifest
    assert len(bench.camera.fired) == fired
    assert verify(bench.root)[1] == []


def test_frames_that_were_set_aside_make_their_bracket_void(taken: dict[str, Path], tmp_path: Path) -> None:
    root = copied(taken["whole"], tmp_path / "silk", FRAMES).root
    sidecar = read_sidecars(root)[0][0]
    (root / "superseded" / "0").mkdir(parents=True)
    for frame in sidecar.frames:
        (root / frame["file"]).rename(root / "superseded" / "0" / Path(frame["file"]).name)
    (root / JOURNAL).unlink()
    (root / COPY).unlink()
    found = repair(root)
    assert (found.proven, found.void, found.gone) == (15, 1, [])
    assert read(root / JOURNAL)[0][-1]["t"] == "superseded"


def test_the_light_of_a_sample_is_not_forgotten(taken: dict[str, Path], tmp_path: Path) -> None:
    root = copied(taken["whole"], tmp_path / "silk", FRAMES).root
    before = light_dose(read(root / JOURNAL)[0])
    assert before.open_s > 0
    (root / JOURNAL).unlink()
    (root / COPY).unlink()
    repair(root)
    assert light_dose(read(root / JOURNAL)[0]) == before


@pytest.mark.parametrize("harm", ["CRLF", "UTF-16", "UTF-16 without mark, CRLF", "UTF-8 with mark"])
def test_a_converted_journal_is_read(taken: dict[str, Path], harm: str) -> None:
    """All of it, without help from a copy or from sidecars."""
    text = (taken["whole"] / JOURNAL).read_bytes()
    converted = DAMAGES[harm](text)
    assert converted is not None
    assert b"".join(line(record) for record in sound_lines(converted)) == text


def test_a_frame_that_is_in_quarantine_is_not_proven(bench: Bench) -> None:
    """A session was killed after it had found a bracket void, which its sidecar does not say."""
    bench.capture(PLAN)
    number, sidecar = max(read_sidecars(bench.root)[0].items())
    frame = sidecar.frames[0]
    aside = bench.root / "quarantine" / f"{frame['sha256'][:12]}_IMG_00001.raw"
    aside.parent.mkdir()
    shutil.copy(bench.root / frame["file"], aside)
    (bench.root / JOURNAL).unlink()
    (bench.root / COPY).unlink()
    assert repair(bench.root).proven == 15
    assert read_brackets(read(bench.root / JOURNAL)[0])[number].void


def test_a_line_that_only_the_copy_has(taken: dict[str, Path], tmp_path: Path) -> None:
    bench = copied(taken["whole"], tmp_path / "silk", FRAMES)
    journal = bench.root / JOURNAL
    text = journal.read_bytes()
    journal.write_bytes(b"".join(split(text)[:-1]))
    with pytest.raises(InputError, match=r"lacks line \d+ of its copy .*run `kinran rig repair silk`"):
        bench.capture(PLAN)
    repair(bench.root)
    assert journal.read_bytes() == text


def test_a_damaged_copy_is_made_anew(taken: dict[str, Path], tmp_path: Path) -> None:
    """It says nothing of the journal, which is sound."""
    bench = copied(taken["whole"], tmp_path / "silk", FRAMES)
    damage(bench.root / COPY, DAMAGES["flipped in the middle"])
    bench.capture(PLAN, devices=None)
    assert (bench.root / COPY).read_bytes() == (bench.root / JOURNAL).read_bytes()


@pytest.mark.parametrize("journal", [True, False], ids=["journal", "manifest alone"])
def test_what_verify_finds(taken: dict[str, Path], tmp_path: Path, journal: bool) -> None:
    """A missing, a cut, a changed and an unknown frame, and a manifest that is older than the journal."""
    bench = copied(taken["whole"], tmp_path / "silk", FRAMES)
    manifest = bench.capture(PLAN, devices=None)
    frames = [bench.root / frame["file"] for shot in manifest["shots"] for frame in shot["frames"]]
    write_json(bench.root / "groups" / "00.json", manifest)
    assert verify(bench.root) == (FRAMES, [])
    if not journal:
        (bench.root / JOURNAL).unlink()
        (bench.root / "frames").rename(bench.root / "photographs")
        text = (bench.root / "groups" / "00.json").read_text().replace('"frames/', '"photographs/')
        write_json(bench.root / "groups" / "00.json", json.loads(text))
        frames = [bench.root / "photographs" / frame.relative_to(bench.root / "frames") for frame in frames]
        assert verify(bench.root) == (FRAMES, [])
    frames[1].unlink()
    frames[2].write_bytes(frames[2].read_bytes()[:-1])
    frames[3].write_bytes(flipped(frames[3].read_bytes(), 7))
    wrong = [f"{frames[1]}: is missing", *(f"{frames[k]}: has other bytes than were recorded" for k in (2, 3))]
    if journal:
        stray = frames[0].with_name("notes.txt")
        stray.write_text("x")
        wrong.append(f"{stray}: is no frame that the journal or a manifest knows")
        manifest["shots"][5]["frames"][0]["sha256"] = "0" * 64
        write_json(bench.root / "groups" / "00.json", manifest)
        name = manifest["shots"][5]["frames"][0]["file"]
        wrong.append(f"{bench.root / 'groups/00.json'}: names other bytes of {name} than the journal; make it anew")
    count, found = verify(bench.root)
    assert count == FRAMES
    assert sorted(found) == sorted(wrong)


def test_only_names_of_frames_count(bench: Bench) -> None:
    bench.capture(PLAN)
    (bench.root / "frames" / "00" / "Thumbs.db").write_bytes(b"x")
    bench.capture(PLAN, devices=None)
    (bench.root / "frames" / "00" / "t85_p000_e0_r0.raw").write_bytes(b"x")
    with pytest.raises(InputError, match=r"t85_p000_e0_r0.raw: is there, but journal.jsonl does not know it"):
        bench.capture(PLAN)
    assert len(verify(bench.root)[1]) >= 2


def test_a_sidecar_records_the_last_bracket_when_the_card_is_gone(bench: Bench) -> None:
    """Killed before the frame records: the frames are on disk, and need not be on the card."""
    with pytest.MonkeyPatch.context() as patch:

        def die(self: Journal, *records: Any) -> None:
            if records[0]["t"] == "frame":
                raise KeyboardInterrupt
            append(self, *records)

        append = Journal.append
        patch.setattr(Journal, "append", die)
        with pytest.raises(KeyboardInterrupt):
            bench.capture(PLAN)
    assert "frame" not in {record["t"] for record in read(bench.root / JOURNAL)[0]}
    for path in bench.camera.folder.iterdir():
        path.unlink()
    check(bench.root, PLAN, bench.capture(PLAN))
    assert len(bench.camera.fired) == FRAMES


@pytest.mark.parametrize("step", ["delete", "complete"])
def test_recorded_frames_that_are_left_on_the_card_are_fetched_away(bench: Bench, step: str) -> None:
    """Killed after the last frame record: a later run tidies the card, and only once."""
    with pytest.MonkeyPatch.context() as patch:
        append, delete = Journal.append, bench.camera.delete

        def no_complete(self: Journal, *records: Any) -> None:
            if records[0]["t"] == "complete":
                raise KeyboardInterrupt
            append(self, *records)

        def no_delete(name: str) -> None:
            if len(bench.camera.fired) == FRAMES:
                raise KeyboardInterrupt
            delete(name)

        if step == "complete":
            patch.setattr(Journal, "append", no_complete)
        else:
            patch.setattr(bench.camera, "delete", no_delete)
        with pytest.raises(KeyboardInterrupt):
            bench.capture(PLAN)
    assert len(bench.camera.card()) == (3 if step == "delete" else 0)
    bench.capture(PLAN)
    assert bench.camera.card() == []
    assert len(bench.camera.fired) == FRAMES
    assert read(bench.root / JOURNAL)[0][-1]["t"] == "complete"
    bench.capture(PLAN, devices=None)


@pytest.mark.parametrize("call", [1, 6, 20])
@pytest.mark.parametrize(
    ("number", "said"), [(errno.EIO, "the disk fails"), (errno.EROFS, "the disk can only be read")]
)
def test_a_disk_that_fails_is_one_sentence(
    bench: Bench, number: int, said: str, call: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In a write of the journal, of a frame, or of a copy."""
    real, calls = os.fsync, []

    def failing(file: int) -> None:
        calls.append(file)
        if len(calls) == call:
            raise OSError(number, os.strerror(number))
        real(file)

    monkeypatch.setattr(os, "fsync", failing)
    with pytest.raises(InputError, match=f"silk: {said}.* and run the capture again"):
        bench.capture(PLAN)
    monkeypatch.undo()
    check(bench.root, PLAN, bench.capture(PLAN))
    assert len(bench.camera.fired) <= FRAMES + len(EXPOSURES)


@pytest.mark.parametrize("number", [errno.EIO, errno.EROFS])
def test_a_copy_that_cannot_be_written_is_one_sentence(
    bench: Bench, number: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The group is shot all the same."""

    def failing(self: Path, *args: Any) -> Path:
        if self.name == f"{COPY}.part":
            raise OSError(number, os.strerror(number), str(self))
        return real(self, *args)

    real = Path.replace
    monkeypatch.setattr(Path, "replace", failing)
    with pytest.raises(InputError, match=f"{COPY}.part: the disk .* and run the capture again"):
        bench.capture(PLAN)
    monkeypatch.undo()
    check(bench.root, PLAN, bench.capture(PLAN, devices=None))
    assert (bench.root / COPY).read_bytes() == (bench.root / JOURNAL).read_bytes()
    assert not list(bench.root.glob("*.part"))


def test_a_frame_and_a_journal_that_cannot_be_read(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    manifest = bench.capture(PLAN)
    names = {JOURNAL, Path(manifest["shots"][0]["frames"][0]["file"]).name}
    real = Path.open

    def failing(self: Path, *args: Any, **other: Any) -> Any:
        if self.name in names:
            raise OSError(errno.EIO, os.strerror(errno.EIO), str(self))
        return real(self, *args, **other)

    names.remove(JOURNAL)
    monkeypatch.setattr(Path, "open", failing)
    assert "cannot be read (Input/output error)" in verify(bench.root)[1][0]
    assert repair(bench.root).proven == 15
    names.add(JOURNAL)
    with pytest.raises(InputError, match=r"cannot be read .Input/output error"):
        bench.capture(PLAN)


@pytest.mark.parametrize("number", [errno.ENOSPC, errno.EIO])
def test_a_disk_that_fails_in_a_repair(
    taken: dict[str, Path], tmp_path: Path, number: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The damaged journal is there until the new one is whole."""
    root = copied(taken["whole"], tmp_path / "silk", FRAMES).root
    damage(root / JOURNAL, DAMAGES["flipped in the middle"])
    harmed = (root / JOURNAL).read_bytes()

    def failing(file: int) -> None:
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr(os, "fsync", failing)
    with pytest.raises(InputError, match=r"silk: the disk .* and run the repair again"):
        repair(root)
    monkeypatch.undo()
    assert (root / JOURNAL).read_bytes() == harmed
    assert repair(root).proven == 16


def test_a_repair_waits_for_no_capture(bench: Bench) -> None:
    bench.capture(PLAN)
    with Journal(bench.root / JOURNAL):
        with pytest.raises(InputError, match="is running"):
            repair(bench.root)
        with pytest.raises(InputError, match="is running"):
            verify(bench.root)


def test_a_journal_that_a_repair_replaced_meanwhile_is_not_locked(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    bench.capture(PLAN)
    path = bench.root / JOURNAL
    real = os.open

    def slow(name: Any, *args: Any) -> int:
        file = real(name, *args)
        if name == path:
            shutil.copy(path, bench.root / "new")
            (bench.root / "new").replace(path)
        return file

    monkeypatch.setattr(os, "open", slow)
    with pytest.raises(InputError, match="another capture or repair"):
        lock(path)


def test_a_record_of_a_bracket_that_is_not_there(bench: Bench) -> None:
    path = bench.root / JOURNAL
    path.parent.mkdir(exist_ok=True)
    path.write_bytes(line({"t": "frame", "intent": 0, "k": 0}))
    with pytest.raises(InputError, match="line 1 names a bracket"):
        bench.capture(PLAN)


def test_command_line(bench: Bench, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    (bench.root.parent / "captures").mkdir()
    root = bench.root.rename(bench.root.parent / "captures" / "silk")
    bench = Bench(root)
    manifest = bench.capture(PLAN)
    monkeypatch.chdir(root.parent.parent)
    assert main(["rig", "verify"]) == 0
    assert "silk: 48 files are as they were recorded" in capsys.readouterr().out
    frame = root / manifest["shots"][0]["frames"][0]["file"]
    frame.write_bytes(b"rot")
    assert main(["rig", "verify", "silk"]) == 2
    said = capsys.readouterr()
    assert f"{frame.relative_to(root.parent.parent)}: has other bytes" in said.out
    assert "run `kinran rig repair silk`, then capture its groups again" in said.err
    assert main(["rig", "repair", "silk"]) == 0
    said = capsys.readouterr()
    assert "15 brackets with 45 frames are proven" in said.out
    assert "is not proven" in said.out
    assert main(["rig", "repair", "wool"]) == 2
    assert main(["rig", "repair", "../silk"]) == 2
    assert DEVICE == {"device": "fake"}
