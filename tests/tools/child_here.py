"""Children of `base.child` in the process of their test: a socket pair whose ends the test holds."""

import socket

from base.child import Child, Parent


class ParentHere(Parent):
    """The child's end."""

    def __init__(self, end: socket.socket) -> None:
        self._socket, self._received, self.descriptors = end, bytearray(), []


class ChildHere(Child):
    """The parent's end; what is at the other one is for the test to say."""

    def __init__(self, end: socket.socket) -> None:
        self._socket, self._received, self._name, self.process_id = end, bytearray(), "a child process", 0

    def end(self, _timeout_s: float | None = None) -> int:
        self._socket.close()
        return 0

    kill = end
