"""Recovery: real processes are killed, and what they had is there, whole, for exactly one other process."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

import previs
from previs.ui import recovery as module
from previs.ui.recovery import Recovery, RecoveryState

STATE = RecoveryState(os.path.abspath("/shots/plume.usda"), "#usda 1.0\nover…\n", {"exposure": 1.5, "orbit": [1, 2]})

#: Saves a state, says so and waits to be killed.
SAVE_AND_WAIT = """
import sys, time
from previs.ui.recovery import Recovery, RecoveryState
recovery = Recovery(sys.argv[1])
recovery.tick(lambda: RecoveryState("/shots/a.usda", "edits of " + sys.argv[2], {"n": 1}), 0.0)
print("saved", flush=True)
time.sleep(60)
"""

#: Saves one state after the other without a pause: n times the letter that n stands for.
SAVE_AGAIN_AND_AGAIN = """
import sys
from previs.ui.recovery import Recovery, RecoveryState
recovery = Recovery(sys.argv[1])
n = 0
while True:
    n += 1
    state = RecoveryState("/shots/a.usda", "abcdefgh"[n % 8] * 300_000 + str(n), {"n": n})
    recovery.tick(lambda: state, float(n), force=True)
    if n == 3:
        print("saving", flush=True)
"""

#: Takes what is there, says how it went and waits.
TAKE_AND_WAIT = """
import sys, time
from previs.ui.recovery import Recovery
recovery = Recovery(sys.argv[1])
print([recovery.take(e).snapshot for e in recovery.pending()], flush=True)
time.sleep(60)
"""


@pytest.fixture
def start():
    """Starts a process that runs some code and has said its first line; all are killed at the end."""
    processes = []

    def run(code: str, *arguments) -> tuple[subprocess.Popen, str]:
        process = subprocess.Popen(
            [sys.executable, "-c", code, *map(str, arguments)], stdout=subprocess.PIPE, text=True
        )
        processes.append(process)
        line = process.stdout.readline()
        assert line, "the process died"
        return process, line.strip()

    yield run
    for process in processes:
        process.kill()
        process.wait()
        process.stdout.close()


def kill(process: subprocess.Popen) -> None:
    process.send_signal(signal.SIGKILL if os.name != "nt" else signal.SIGTERM)
    process.wait()


def test_a_killed_process_leaves_its_edits(start, tmp_path):
    process, _ = start(SAVE_AND_WAIT, tmp_path, "one")
    recovery = Recovery(tmp_path)
    # While it lives it is nobody's business.
    assert recovery.pending() == []
    kill(process)
    (entry,) = recovery.pending()
    assert entry.stage == os.path.abspath("/shots/a.usda")
    assert abs(time.time() - entry.saved_at.timestamp()) < 60.0
    assert (entry.snapshot, entry.view) == ("edits of one", {"n": 1})
    assert recovery.take(entry) == RecoveryState(entry.stage, "edits of one", {"n": 1})
    assert recovery.pending() == []
    recovery.forget(entry)
    assert list(tmp_path.iterdir()) == []
    assert Recovery(tmp_path).pending() == []


def test_several_processes_the_latest_first(start, tmp_path):
    processes = [start(SAVE_AND_WAIT, tmp_path, name)[0] for name in ("one", "two", "three")]
    for i in (0, 2):
        kill(processes[i])
    recovery = Recovery(tmp_path)
    entries = recovery.pending()
    assert [recovery.take(e).snapshot for e in entries] == ["edits of three", "edits of one"]
    kill(processes[1])
    (entry,) = recovery.pending()
    assert recovery.take(entry).snapshot == "edits of two"


def test_a_kill_in_the_middle_of_writing_leaves_a_whole_state(start, tmp_path):
    for attempt in range(6):
        folder = tmp_path / str(attempt)
        process, _ = start(SAVE_AGAIN_AND_AGAIN, folder)
        time.sleep(0.003 * attempt)
        kill(process)
        recovery = Recovery(folder)
        (entry,) = recovery.pending()
        state = recovery.take(entry)
        n = state.view["n"]
        assert state.snapshot == "abcdefgh"[n % 8] * 300_000 + str(n)
        assert n >= 3
        recovery.forget(entry)
        # The half-written file is gone too.
        assert list(folder.iterdir()) == []


def test_only_one_process_takes_an_entry(start, tmp_path):
    victim, _ = start(SAVE_AND_WAIT, tmp_path, "one")
    kill(victim)
    mine = Recovery(tmp_path)
    (entry,) = mine.pending()
    other, line = start(TAKE_AND_WAIT, tmp_path)
    assert line == "['edits of one']"
    assert Recovery(tmp_path).pending() == []
    for use in (mine.take, mine.forget):
        with pytest.raises(previs.PrevisError, match="taken by another process"):
            use(entry)
    # It dies before it has forgotten the entry: nothing is lost.
    kill(other)
    (entry,) = mine.pending()
    assert mine.take(entry).snapshot == "edits of one"


def test_what_is_gone_cannot_be_taken(start, tmp_path):
    victim, _ = start(SAVE_AND_WAIT, tmp_path, "one")
    kill(victim)
    one, two = Recovery(tmp_path), Recovery(tmp_path)
    (entry,) = one.pending()
    two.forget(entry)
    with pytest.raises(previs.PrevisError) as error:
        one.take(entry)
    assert "\n" not in str(error.value)
    one.forget(entry)
    assert list(tmp_path.iterdir()) == []


def test_it_is_saved_when_it_changed_and_not_too_often(tmp_path):
    recovery = Recovery(tmp_path, interval=4.0)
    calls = []

    def tick(now, state, force=False):
        return recovery.tick(lambda: calls.append(now) or state, now, force)

    changed = RecoveryState(STATE.stage, STATE.snapshot + "more", STATE.view)
    assert tick(10.0, STATE)
    assert not tick(13.9, changed) and calls == [10.0]
    assert tick(14.0, changed) and calls == [10.0, 14.0]
    assert not tick(18.0, changed)
    assert not tick(18.1, STATE)
    assert tick(18.2, STATE, force=True)
    (path,) = tmp_path.glob("*.json")
    content = json.loads(path.read_text())
    assert (content["stage"], content["snapshot"], content["view"]) == (
        STATE.stage,
        STATE.snapshot,
        STATE.view,
    )
    # Saved by the user: nothing to recover. Then there is something again.
    assert not tick(30.0, None)
    assert list(tmp_path.glob("*.json")) == []
    assert tick(40.0, STATE)
    assert len(list(tmp_path.glob("*.json"))) == 1
    recovery.close()


def test_a_clean_exit_leaves_nothing(tmp_path):
    recovery = Recovery(tmp_path)
    recovery.tick(lambda: STATE, 0.0)
    assert recovery.pending() == []
    recovery.close()
    assert list(tmp_path.iterdir()) == []
    recovery.close()
    # One that never had anything to save does not even make the folder.
    idle = Recovery(tmp_path / "idle")
    idle.tick(lambda: None, 0.0)
    assert idle.pending() == []
    idle.close()
    assert not (tmp_path / "idle").exists()


def test_what_was_taken_is_offered_again_after_a_clean_exit(start, tmp_path):
    victim, _ = start(SAVE_AND_WAIT, tmp_path, "one")
    kill(victim)
    recovery = Recovery(tmp_path)
    recovery.take(*recovery.pending())
    recovery.close()
    assert len(Recovery(tmp_path).pending()) == 1


def test_relative_paths_become_absolute(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    recovery = Recovery(tmp_path / "r")
    recovery.tick(lambda: RecoveryState("plume.usda", "", {}), 0.0)
    (path,) = (tmp_path / "r").glob("*.json")
    assert json.loads(path.read_text())["stage"] == str(tmp_path / "plume.usda")
    recovery.close()


@pytest.mark.parametrize(
    "content",
    [
        "",
        "{",
        "[]",
        "{}",
        "\0" * 9,
        '{"stage": 1, "snapshot": "", "view": {}, "saved_at": 1.0}',
        '{"stage": "", "snapshot": "", "view": {}, "saved_at": 1e300}',
        '{"stage": "", "snapshot": "", "view": {}, "saved_at": NaN}',
    ],
)
def test_damaged_files_are_set_aside(tmp_path, content):
    (tmp_path / "session-1-x.json").write_text(content)
    recovery = Recovery(tmp_path)
    assert recovery.pending() == []
    assert "damaged" in recovery.problem and "\n" not in recovery.problem
    assert [p.name for p in tmp_path.iterdir()] == ["session-1-x.json.damaged"]
    recovery.problem = ""
    assert recovery.pending() == [] and recovery.problem == ""
    assert [p.name for p in tmp_path.iterdir()] == ["session-1-x.json.damaged"]


def test_a_disk_that_refuses_is_said_once_it_does_and_no_longer(tmp_path, monkeypatch):
    recovery = Recovery(tmp_path)

    def refuse(*_):
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr(module, "write_atomically", refuse)
        assert not recovery.tick(lambda: STATE, 0.0)
        assert "No space left" in recovery.problem and "\n" not in recovery.problem
    assert recovery.tick(lambda: STATE, 10.0)
    assert recovery.problem == ""
    recovery.close()
    (tmp_path / "file").write_text("")
    blocked = Recovery(tmp_path / "file")
    assert not blocked.tick(lambda: STATE, 0.0) and blocked.problem
    assert blocked.pending() == []
    blocked.close()


def test_a_lock_file_removed_by_a_tidying_process_is_made_again(tmp_path, monkeypatch):
    acquire, removed = module._acquire, []

    def meddled(path: Path, create: bool):
        handle = acquire(path, create)
        if not removed:
            path.unlink()
            removed.append(path)
        return handle

    monkeypatch.setattr(module, "_acquire", meddled)
    recovery = Recovery(tmp_path)
    assert recovery.tick(lambda: STATE, 0.0)
    monkeypatch.undo()
    assert len(list(tmp_path.glob("*.lock"))) == 1
    assert Recovery(tmp_path).pending() == []
    recovery.close()
    assert list(tmp_path.iterdir()) == []
