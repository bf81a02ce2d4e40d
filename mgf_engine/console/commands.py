# SPDX-License-Identifier: GPL-3.0-or-later
"""Common parts of the commands on finished jobs: options, progress, cancelling, one sentence for each failure."""

from __future__ import annotations

import _thread
import argparse
import contextlib
import logging
import math
import signal
import sys
import threading
import traceback
from collections.abc import Callable, Iterator
from typing import Any

from mgf_engine.console.terminal import drop_output, make_sink
from mgf_engine.errors import EXIT_CANCELLED, EXIT_DONE, EXIT_FAULT, BadInput, explain
from mgf_engine.messages import Reporter
from mgf_engine.options.algorithms import algorithm_values, check_used
from mgf_engine.options.user_input import option_pairs, read_config

#: Seconds after Ctrl-C until a command stops wherever it is that writes its files beside the old ones.
PATIENCE = 0.5
#: What whoever presses Ctrl-C reads at once: the next step may be some seconds away.
STOPPING = "Stopping at the next step; Ctrl-C again stops at once."


def read_algorithm_options(args: argparse.Namespace, command: str) -> dict[str, Any]:
    """Read options of the algorithms that a command was given, ``section.name`` -> value; ``--set`` wins over the file.

    Raises:
        BadInput: an option that the command does not use, or a value that the option does not take.
    """
    user_options = {**(read_config(args.config) if args.config else {}), **option_pairs(args.set)}
    check_used(command, user_options)
    algorithm_values(user_options)  # checks them; one given at its default has to win over the job's
    return user_options


def read_number(flag: str, text: str | None, what: str) -> float | None:
    """Read a number above 0; None where it was not given.

    Raises:
        BadInput: it is none.
    """
    if text is None:
        return None
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not 0 < value < math.inf:
        raise BadInput(f"{flag} takes {what} above 0, not '{text}'.")
    return value


def run_reported(args: argparse.Namespace, work: Callable[[Reporter], object], patience: float | None = None) -> int:
    """Do the work with a reporter in the style that was asked for; returns the exit code.

    Whatever ends it early is one ``failed`` message, as of a job.

    Args:
        args: of the command.
        work: what it does.
        patience: seconds after Ctrl-C from which the work is stopped wherever it is; None where it has to reach a step.
    """
    if not logging.getLogger("mgf").handlers:  # without a job's log, Python would print warnings a second time
        logging.getLogger("mgf").addHandler(logging.NullHandler())
    reporter = Reporter(make_sink(args.progress))
    try:
        with watch_for_cancel(reporter, args.cancel_on_eof, patience):
            work(reporter)
        return EXIT_DONE
    except (Exception, KeyboardInterrupt) as error:
        code, text = explain(error, resumable=False, place=getattr(args, "out", None))
        if code == EXIT_FAULT:
            traceback.print_exception(error)
        if code == EXIT_CANCELLED:
            text = "Cancelled; what was there before is unchanged."
        send_failed(reporter, code, text)
        return code
    finally:
        reporter.close()


def send_failed(reporter: Reporter, code: int, text: str, log: str | None = None) -> None:
    """Say that the work ended early and why, even where nobody reads any more.

    Args:
        reporter: where it is said.
        code: exit code.
        text: why, in one sentence.
        log: path of the file with the details.
    """
    try:
        reporter.send("failed", code=code, text=text, log=log)
        sys.stdout.flush()
    except BrokenPipeError:
        drop_output()


@contextlib.contextmanager
def watch_for_cancel(reporter: Reporter, on_eof: bool, patience: float | None = None) -> Iterator[None]:
    """Have Ctrl-C and SIGTERM ask the job inside to stop at its next step; one more Ctrl-C stops it at once.

    The caller's own signal handlers come back at the end. pycolmap, which nearly all commands need, is loaded here: it
    takes SIGTERM for itself then, to end the process with a stack trace, and has to give it back.

    Args:
        reporter: of the job.
        on_eof: stop at the end of standard input, too.
        patience: seconds after which the second Ctrl-C comes by itself, also after the end of standard input; None for
            never.
    """

    def ask(number: int, frame: object) -> None:
        if number == signal.SIGINT and reporter.cancelled:
            # The handler of whoever called knows how to stop while modules are being loaded.
            second = before[signal.SIGINT] if callable(before[signal.SIGINT]) else signal.default_int_handler
            second(number, frame)
            return
        reporter.cancel()
        if number == signal.SIGINT:  # a thread says so: the sinks' locks may be held where the signal came
            answer(_say_stopping, reporter)
        stop_soon()

    def stop_soon() -> None:
        if patience is not None and before:
            answer(_stop_at_once, patience, ended)

    def answer(target: Callable[..., None], *arguments: object) -> None:
        answers.append(threading.Thread(target=target, args=arguments))
        answers[-1].start()

    answers: list[threading.Thread] = []
    ended = threading.Event()
    before: dict[int, Any] = {}
    if threading.current_thread() is threading.main_thread():
        before = {number: signal.signal(number, ask) for number in (signal.SIGINT, signal.SIGTERM)}
        import pycolmap  # noqa: F401

        signal.signal(signal.SIGTERM, ask)
    if on_eof:
        threading.Thread(target=_cancel_on_eof, args=(reporter, stop_soon), daemon=True).start()
    try:
        yield
    finally:
        if answers:  # a second Ctrl-C that is just being sent is not the caller's
            signal.signal(signal.SIGINT, lambda *_: None)
        ended.set()
        for thread in answers:
            thread.join()
        for number, handler in before.items():
            if handler is not None:  # one that C set cannot be set again from here
                signal.signal(number, handler)


def _say_stopping(reporter: Reporter) -> None:
    with contextlib.suppress(OSError):  # nobody reads any more
        reporter.send("stopping", text=STOPPING)


def _stop_at_once(patience: float, ended: threading.Event) -> None:
    """Send the main thread the second Ctrl-C, unless it has ended by then."""
    if not ended.wait(patience):
        if sys.platform == "win32":
            _thread.interrupt_main()
        else:  # which ends its waiting for locks and threads as well
            signal.pthread_kill(threading.main_thread().ident or 0, signal.SIGINT)


def _cancel_on_eof(reporter: Reporter, stop_soon: Callable[[], None]) -> None:
    with contextlib.suppress(OSError, ValueError):
        while sys.stdin.readline():
            pass
    reporter.cancel()
    stop_soon()
