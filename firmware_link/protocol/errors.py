"""The root of the project's errors, and the errors of the link by whose fault they are."""


class TactableError(Exception):
    """Root of every error that a user can cause and mend; its text says what, where and the remedy.

    It stands in the lowest room, which every other room may import, so that the command line catches one class.
    """


class LinkError(TactableError):
    """The device, its port or its firmware does not do what the link needs; the text says the remedy."""


class LinkLostError(LinkError):
    """The port or the device behind it is gone, or was rebooted meanwhile: it may come back."""


class MessageError(LinkError):
    """A value that its message cannot carry, or bytes that are not a message."""
