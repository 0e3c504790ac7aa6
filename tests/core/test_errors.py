"""Errors that a user can cause."""

import contextlib
import pickle
import signal
import time
from pathlib import Path

import pytest
import typer

from gpf.cli import run_app
from gpf.core.errors import FileError, UserError, no_lost_interrupts, uninterrupted


def test_it_says_where_what_and_what_to_do():
    assert str(UserError("a.txt", "is empty", "Fill it.")) == "a.txt: is empty. Fill it."


def test_it_travels_between_processes():
    """Workers of a cluster have users, too."""
    error = pickle.loads(pickle.dumps(UserError("a.txt", "is empty", "Fill it.")))
    assert (error.where, error.what, error.todo) == ("a.txt", "is empty", "Fill it.")
    assert str(error) == "a.txt: is empty. Fill it."


@pytest.mark.parametrize(
    ("missing", "todo"), [(True, "Check the path."), (False, "Delete it and make it again.")]
)
def test_an_error_about_a_file_knows_the_file(missing, todo):
    error = pickle.loads(pickle.dumps(FileError(Path("a.txt"), "is odd", missing)))
    assert isinstance(error, UserError)
    assert (error.path, error.missing, error.exit_code) == (Path("a.txt"), missing, 2)
    assert str(error) == f"a.txt: is odd. {todo}"


@pytest.fixture
def interrupts():
    """Ctrl-C as in a terminal: a shell lets processes in the background ignore it."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.mark.usefixtures("interrupts")
def test_an_interrupt_waits_until_the_block_ends():
    done = []
    with pytest.raises(KeyboardInterrupt), uninterrupted():
        signal.raise_signal(signal.SIGINT)
        done.append("first")
        done.append("second")
    assert done == ["first", "second"]
    with no_lost_interrupts(), pytest.raises(KeyboardInterrupt):
        signal.raise_signal(signal.SIGINT)


@pytest.mark.usefixtures("interrupts")
def test_an_interrupt_in_a_destructor_is_not_lost():
    class Interrupted:
        def __del__(self):
            signal.raise_signal(signal.SIGINT)

    with no_lost_interrupts(), pytest.raises(KeyboardInterrupt):
        Interrupted()
        time.sleep(5)


@pytest.mark.usefixtures("interrupts")
def test_an_interrupt_that_became_another_error_is_known(capsys):
    """As in libraries in C++ that call Python and report a failure of their own."""
    commands = typer.Typer()

    @commands.command()
    def draw(interrupted: bool = False) -> None:
        if interrupted:
            with contextlib.suppress(KeyboardInterrupt):
                signal.raise_signal(signal.SIGINT)
        raise ValueError("Invalid matrix")

    with pytest.raises(SystemExit) as ending:
        run_app(commands, ["--interrupted"])
    assert ending.value.code == 130 and "stopped" in capsys.readouterr().err
    with pytest.raises(ValueError, match="Invalid matrix"):
        run_app(commands, [])
