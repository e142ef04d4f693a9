"""The errors of the link, by whose fault they are."""

from base.errors import TactableError


class LinkError(TactableError):
    """The device, its port or its firmware does not do what the link needs; the text says the remedy."""


class LinkLostError(LinkError):
    """The port or the device behind it is gone, or was rebooted meanwhile: it may come back."""


class MessageError(LinkError):
    """A value that its message cannot carry, or bytes that are not a message."""
