"""The process that draws: answers in order, errors that arrive, no process that stays."""

import os
import signal
import time
from pathlib import Path

import pytest

from kc2spice.core.errors import SimulationError
from kc2spice.report.plotworker import PlotWorker


def double(value):
    return 2 * value


def identity():
    return os.getpid()


def fail(number):
    raise OSError(number, os.strerror(number), "picture.png")


def refuse():
    raise SimulationError("no picture", where="here", hint="none")


def sleep():
    time.sleep(600)


def alive(pid):
    try:
        state = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
    except FileNotFoundError:
        return False
    return state != "Z"


def test_it_draws_elsewhere_and_in_order():
    with PlotWorker() as worker:
        futures = [worker.draw(double, k) for k in range(5)]
        pid = worker.draw(identity).result(60)
        assert pid != os.getpid()
        assert [f.result(60) for f in futures] == [0, 2, 4, 6, 8]
        big = bytes(10_000_000)  # more than a pipe holds
        assert len(worker.draw(double, big).result(60)) == 2 * len(big)
    assert not alive(pid)


def test_errors_arrive_as_they_were_and_the_next_picture_is_drawn():
    with PlotWorker() as worker:
        full, refused = worker.draw(fail, 28), worker.draw(refuse)
        with pytest.raises(OSError, match="No space left") as caught:
            full.result(60)
        assert caught.value.errno == 28
        with pytest.raises(SimulationError) as said:
            refused.result(60)
        assert (said.value.where, said.value.hint) == ("here", "none")
        assert worker.draw(double, 4).result(60) == 8


def test_a_killed_process_is_an_error_and_not_a_wait():
    with PlotWorker() as worker:
        os.kill(worker.draw(identity).result(60), signal.SIGKILL)
        with pytest.raises(SimulationError, match="ended before its pictures"):
            worker.draw(double, 1).result(60)


def test_nobody_waits_for_pictures_of_a_failed_run():
    begin = time.monotonic()
    with pytest.raises(RuntimeError), PlotWorker() as worker:
        worker.draw(sleep)
        raise RuntimeError
    assert time.monotonic() - begin < 60.0


def test_it_ends_with_the_process_that_asked(tmp_path):
    """As after a kill: the other end is closed, nothing else is said."""
    pid = os.fork()
    if pid == 0:
        with PlotWorker() as worker:
            tmp_path.joinpath("pid").write_text(str(worker.draw(identity).result(60)))
            os.kill(os.getpid(), signal.SIGKILL)
    os.waitpid(pid, 0)
    drawing = int(tmp_path.joinpath("pid").read_text())
    deadline = time.monotonic() + 60.0
    while alive(drawing) and time.monotonic() < deadline:
        time.sleep(0.05)
    assert not alive(drawing)
