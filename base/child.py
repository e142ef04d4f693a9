"""Child processes of our own: one protocol to start them, talk with them and end them.

A child is `python -P -m base.child MODULE`: it calls `MODULE.main(parent, arguments)`. Its standard input and
output are one Unix socket, whose other end the parent holds.

- The parent writes lines of JSON: first the arguments, then whatever the child understands. A value of a type of ours,
  which JSON does not have, travels in them pickled: downwards alone, since a child may read what strangers wrote. The
  end of the stream asks the child to end. The system closes the socket of a parent that was killed, too, so a child
  that watches its `Parent` ends with it; a child that computes and does not look calls `Parent.end_with_it`.
- The child writes lines of JSON: first that it is ready, at the end perhaps `{"error": text}`. The parent raises that
  text as a ChildError. Standard error is inherited, so notes and tracebacks appear at once.
- Each child leads a session of its own: Ctrl-C in a terminal reaches the parent only, which ends its children in order.

Descriptors travel with a line, which a pipe could not carry. `multiprocessing` would import the parent's main module in
the child and leave it in the parent's session; a fresh interpreter starts in a known state.
"""

import base64
import contextlib
import ctypes
import importlib
import json
import os
import pickle
import select
import signal
import socket
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Self

from base.errors import TactableError

START_TIMEOUT_S = 30.0  # an interpreter starts in 0.1 s on an idle machine, and in seconds on a crowded one
_END_TIMEOUT_S = 10.0  # a child ends in well under a second; one that hangs is killed, and its parent waits no longer
_READ_SIZE = 1 << 16
_MOST_DESCRIPTORS = 4
_PR_SET_PDEATHSIG = 1
_PICKLE = "pickle"  # the only key of an object that stands for a value of ours
Document = dict[str, Any]


class ChildError(TactableError):
    """A child process failed or ended by itself: which one, and its last words."""


def command_of(module: str) -> list[str]:
    """The command line of a child that runs `main(parent, arguments)` of `module`.

    -P: the child imports what is installed, as its parent does, and not what happens to lie in the working folder, such
    as a checkout beside an installed copy, whose kernels would be compiled a second time.
    """
    return [sys.executable, "-P", "-m", "base.child", module]


def encode_line(document: Document) -> bytes:
    """One line of the stream."""
    return json.dumps(document, default=_pickled).encode() + b"\n"


def _pickled(value: object) -> Document:
    return {_PICKLE: base64.b64encode(pickle.dumps(value)).decode()}


def _unpickled(found: Document) -> Any:
    return pickle.loads(base64.b64decode(found[_PICKLE])) if found.keys() == {_PICKLE} else found


def decode_line(line: bytes, name: str) -> Document:
    """The document of a line; raises ChildError for the last words of the child that is called `name`."""
    document: Document = json.loads(line)
    if "error" in document:
        raise ChildError(f"{name}: {document['error']}")
    return document


def ending_text(status: int) -> str:
    """How a process ended, by the exit status that `Popen` has for it."""
    return f"was ended by {signal.Signals(-status).name}" if status < 0 else f"ended with exit status {status}"


class Child:
    """A running child process, ended at the end of a `with` block. `name` is what errors call it."""

    def __init__(
        self, module: str, arguments: Document, *, name: str = "a child process", descriptors: Sequence[int] = ()
    ) -> None:
        self._name = name
        self._socket, theirs = socket.socketpair()
        with theirs:
            end = theirs.fileno()
            self._process = subprocess.Popen(
                command_of(module), stdin=end, stdout=end, pass_fds=descriptors, start_new_session=True
            )
        self.process_id = self._process.pid
        self._received = bytearray()
        self.write(arguments)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *unused: object) -> None:
        self.end()

    def fileno(self) -> int:
        """The socket: readable when the child has said something, or has ended."""
        return self._socket.fileno()

    def write(self, document: Document, descriptors: Sequence[int] = ()) -> None:
        """Say a line, and hand copies of descriptors over; a child that has ended does not hear it."""
        line = encode_line(document)
        with contextlib.suppress(BrokenPipeError, ConnectionResetError):  # the next `read` says why it has ended
            sent = socket.send_fds(self._socket, [line], descriptors)
            self._socket.sendall(line[sent:])

    def read(self, timeout_s: float | None = None) -> Document:
        """The next line. Raises ChildError for last words, an end without any, and one silent for `timeout_s`."""
        while (end := self._received.find(b"\n")) < 0:
            if not select.select([self._socket], [], [], timeout_s)[0]:
                raise ChildError(f"{self._name} has said nothing for {timeout_s:g} s")
            data = b""
            with contextlib.suppress(ConnectionResetError):  # ended with a line unread
                data = self._socket.recv(_READ_SIZE)
            if not data:
                raise ChildError(f"{self._name} {ending_text(self._process.wait())}")
            self._received += data
        line = bytes(self._received[:end])
        del self._received[: end + 1]
        return decode_line(line, self._name)

    def has_spoken(self) -> bool:
        """Whether `read` would return or raise at once."""
        return b"\n" in self._received or bool(select.select([self._socket], [], [], 0.0)[0])

    def ask(self, document: Document, timeout_s: float | None = None) -> Document:
        """Say a line, and wait for the answer."""
        self.write(document)
        return self.read(timeout_s)

    def ask_to_end(self) -> None:
        """End the stream to the child; what it says until it ends can still be read."""
        with contextlib.suppress(OSError):  # it has ended already
            self._socket.shutdown(socket.SHUT_WR)

    def end(self, timeout_s: float | None = _END_TIMEOUT_S) -> int:
        """Close the stream and wait; kill a child that takes longer. Its exit status."""
        self._socket.close()
        try:
            return self._process.wait(timeout_s)
        except subprocess.TimeoutExpired:
            return self.kill()

    def kill(self) -> int:
        """End a child that has nothing to finish. Its exit status."""
        self._socket.close()
        self._process.kill()
        return self._process.wait()


class Parent:
    """The child's end of the stream: readable when the parent has said something, or asks for the end."""

    def __init__(self) -> None:
        # The stream leaves descriptors 0 and 1: grandchildren and a stray `print` must not reach it.
        self._socket = socket.socket(fileno=os.dup(sys.stdin.fileno()))
        with Path(os.devnull).open("rb") as nothing:
            os.dup2(nothing.fileno(), sys.stdin.fileno())
        os.dup2(sys.stderr.fileno(), sys.stdout.fileno())
        self._received = bytearray()
        self.descriptors: list[int] = []  # those that came with the lines so far; their user removes and closes them

    def fileno(self) -> int:
        """The socket."""
        return self._socket.fileno()

    def read(self) -> Document | None:
        """The next line; None once the parent asks for the end or is gone."""
        while (end := self._received.find(b"\n")) < 0:
            try:
                data, descriptors, _, _ = socket.recv_fds(self._socket, _READ_SIZE, _MOST_DESCRIPTORS)
            except ConnectionResetError:
                return None
            if not data:
                return None
            self._received += data
            self.descriptors += descriptors
        document: Document = json.loads(self._received[:end], object_hook=_unpickled)
        del self._received[: end + 1]
        return document

    def has_spoken(self, timeout_s: float = 0.0) -> bool:
        """Whether `read` would return at once, after a wait of at most `timeout_s`."""
        return b"\n" in self._received or bool(select.select([self._socket], [], [], timeout_s)[0])

    def say(self, document: Document) -> None:
        """Write a line; ends the process when the parent is gone."""
        self.say_bytes(encode_line(document))

    def say_bytes(self, data: bytes) -> None:
        """Write bytes of another form, to a parent that reads the socket itself."""
        try:
            self._socket.sendall(data)
        except (BrokenPipeError, ConnectionResetError):
            raise SystemExit(1) from None

    def end_with_it(self) -> None:
        """Have the system send SIGTERM when the parent's thread that started this process ends."""
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGTERM)
        if self.has_spoken() and self.read() is None:  # it was gone before that
            raise SystemExit(1)


def main() -> None:
    """Run the module that the command line names, and make its errors last words."""
    parent = Parent()
    try:
        if (arguments := parent.read()) is None:
            raise SystemExit(1)
        importlib.import_module(sys.argv[1]).main(parent, arguments)
    except (TactableError, OSError) as error:
        parent.say({"error": str(error)})
        raise SystemExit(1) from None
    except Exception as error:
        parent.say({"error": f"{type(error).__name__}: {error}"})
        raise


if __name__ == "__main__":
    main()
