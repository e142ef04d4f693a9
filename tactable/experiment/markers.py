"""Markers of trials over the Lab Streaming Layer, for recordings of brain or body that run beside an experiment."""

from collections.abc import Callable

from tactable.experiment.protocol import ExperimentError

Mark = Callable[[str], None]


def no_marks(_text: str) -> None:
    """Marks where no stream was asked for."""


def open_stream(name: str, participant: str) -> Mark:
    """Open a stream of texts; what sends one. Raises ExperimentError where pylsl or its library is absent."""
    try:
        from pylsl import StreamInfo, StreamOutlet
    except (ImportError, RuntimeError) as error:
        raise ExperimentError(
            f"markers = 'lsl': pylsl cannot be used here ({error}): pip install 'tactable[lsl]'"
        ) from None
    outlet = StreamOutlet(StreamInfo(name, "Markers", 1, 0, "string", f"tactable-{name}-{participant}"))
    return lambda text: outlet.push_sample([text])
