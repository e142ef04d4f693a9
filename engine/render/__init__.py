"""Table rows to commands within the limits of the connected device."""

from engine.render.commands import SILENCE, Command, DriveCommand, PlayCommand, RendererError
from engine.render.limits import Drive, LimitError, clamp, link_configuration
from engine.render.prepared import Rendering, render_table
from engine.render.renderer import Renderer, WhenNotAchieved

__all__ = [
    "SILENCE",
    "Command",
    "Drive",
    "DriveCommand",
    "LimitError",
    "PlayCommand",
    "Renderer",
    "RendererError",
    "Rendering",
    "WhenNotAchieved",
    "clamp",
    "link_configuration",
    "render_table",
]
