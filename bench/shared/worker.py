"""A process that answers each line of JSON on its standard input with a line of JSON."""

import contextlib
import json
import subprocess
import threading
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

MESSAGE_LINES = 3  # last lines of the messages of a dead worker that an error quotes
CLOSE_TIMEOUT = 20.0  # s from closing a worker to killing it


class WorkerDied(Exception):  # noqa: N818 (the error is the worker's)
    """A worker ended without an answer; the text is the reason."""


class Worker:
    """A worker process. It starts at the first question, and again after a crash.

    Its first line, before any question, is the message that it is ready.
    """

    def __init__(
        self,
        command: Sequence[str | Path],
        *,
        environment: Mapping[str, str],
        messages: Path,  # file of its standard error
        folder: Path | None = None,  # working folder
        timeout: float = 900.0,  # s for an answer, after which the worker is killed
    ) -> None:
        self.ready: dict[str, Any] = {}
        self._command, self._environment, self._folder = command, environment, folder
        self._messages, self._timeout = messages, timeout
        self._process: subprocess.Popen[str] | None = None

    def start(self) -> None:
        """Start the process, unless it runs; return when it is ready."""
        if self._process is not None:
            return
        with self._messages.open("w", encoding="utf-8") as messages:
            self._process = subprocess.Popen(
                self._command,
                env=self._environment,
                cwd=self._folder,
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=messages,
                text=True,
                encoding="utf-8",
            )
        self.ready = self._converse(self._process, None)

    def ask(self, question: Mapping[str, Any]) -> dict[str, Any]:
        """Return the answer; raise `WorkerDied` if there is none."""
        self.start()
        assert self._process is not None
        return self._converse(self._process, question)

    def close(self, timeout: float = CLOSE_TIMEOUT) -> None:
        """End the worker; kill it if it runs on for `timeout` seconds."""
        process, self._process = self._process, None
        if process is None:
            return
        assert process.stdin is not None and process.stdout is not None
        with contextlib.suppress(OSError):  # unsent data cannot be written any more
            process.stdin.close()
        try:
            process.wait(timeout)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
        process.stdout.close()

    def _converse(
        self, process: "subprocess.Popen[str]", question: Mapping[str, Any] | None
    ) -> dict[str, Any]:
        assert process.stdin is not None and process.stdout is not None
        alarm = threading.Timer(self._timeout, process.kill)
        alarm.start()
        try:
            if question is not None:
                process.stdin.write(json.dumps(question) + "\n")
                process.stdin.flush()
            line = process.stdout.readline()
        except OSError:  # the pipe is broken
            line = ""
        finally:
            is_late = not alarm.is_alive()
            alarm.cancel()
        if not line:
            reason = self._end_of(process, is_late)
            self.close(timeout=0)
            raise WorkerDied(reason)
        return json.loads(line)

    def _end_of(self, process: "subprocess.Popen[str]", is_late: bool) -> str:
        if is_late:
            return f"its process was ended after {self._timeout:g} s without an answer"
        code = process.wait()
        words = self._messages.read_text(encoding="utf-8", errors="replace").strip()
        last_lines = " ".join(words.splitlines()[-MESSAGE_LINES:])
        return f"its process died with status {code}" + (f": {last_lines}" if last_lines else "")
