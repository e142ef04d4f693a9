"""Command `experiment`: a protocol asked of a participant, or of a simulated one, to trials, report and curve."""

import asyncio
import contextlib
from collections.abc import Iterator, Sequence
from contextlib import AsyncExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from typer import Argument, Option

from tactable.cli import options
from tactable.cli.console import OUT, note, remark, say

if TYPE_CHECKING:
    from engine.table import Table
    from tactable.experiment.conduct import Mark
    from tactable.experiment.protocol import Protocol, Task
    from tactable.experiment.session import Session, Stimulus
    from tactable.experiment.stage import Prediction
    from tactable.experiment.trial_files import SessionFiles

# Of a trial with two intervals and with one, an answer of a second included: ESTIMATE.
_SECONDS = {True: 4.5, False: 3.5}


def experiment(
    protocol_name: Annotated[str, Argument(metavar="PROTOCOL", help="A protocol file, or the name of a shipped one.")],
    table_name: Annotated[
        str, Argument(metavar="TABLE", help="The table that the run plays, or the name of a shipped device.")
    ] = "reference-a",
    output: Annotated[Path, Option("-o", "--output", help="Folder of trials and report.")] = Path("experiment"),
    participant: Annotated[str, Option(help="Label of the participant, letters and digits; no name.")] = "01",
    plan: Annotated[bool, Option("--plan", help="Say how long and how precise it will be; ask nothing.")] = False,
    observer: Annotated[
        str | None, Option(metavar="SPEC", help="A simulated participant, as threshold=4,lapse=0.02; no engine.")
    ] = None,
    demo: Annotated[bool, Option("--demo", help="Play on a simulated device, on which two fingers rest.")] = False,
    control_socket: options.ControlSocket = None,
    host: Annotated[str, Option(help="Bind the page to this address, to answer on a phone.")] = "127.0.0.1",
) -> None:
    """Ask a person what is felt, trial by trial, to thresholds with intervals.

    The engine is a run with --control, beside this command. The participant answers on a page, on a phone or by keys.
    Every trial is kept at once: the same command again goes on where it was, and remakes the report once all are done.
    """
    from threadpoolctl import threadpool_limits

    from tactable.experiment.protocol import read_protocol
    from tactable.experiment.session import Session
    from tactable.experiment.stage import strongest
    from tactable.experiment.trial_files import SessionFiles

    with _opened(table_name) as table, threadpool_limits(1, "blas"):
        protocol = read_protocol(protocol_name, table.device)
        peak_m_per_s2 = _say_stimuli(strongest(table, protocol), is_wanted=plan)
        files, session = SessionFiles.of(output, protocol, participant), Session(protocol, participant)
        if plan:
            _say_precision(protocol, session)
            return
        consent = _consent(protocol, session, peak_m_per_s2)
        is_simulated = observer is not None or demo
        files.begin(protocol, participant, table.device, consent, is_simulated=is_simulated)
        rows, dropped = files.resume(session)
        if dropped:
            note(dropped)
        if rows:
            remark(f"goes on after {len(rows)} of {session.total} trials")
        if observer is not None:
            from tactable.experiment.observer import Observer, answer_all
            from tactable.experiment.stage import predicted_columns

            answer_all(session, Observer.parse(observer), lambda trial: predicted_columns(table, trial), files.append)
        elif session.done < session.total:
            from tactable.experiment.conduct import no_marks, open_stream

            mark = open_stream(protocol.name, participant) if protocol.has_markers else no_marks
            try:
                asyncio.run(_ask((protocol, table, session, files), consent, mark, host, control_socket, demo))
            except KeyboardInterrupt:
                remark(f"ended after {session.done} of {session.total} trials; the same command goes on from there")
        _report(protocol, table, files, participant, is_simulated=is_simulated)


@contextlib.contextmanager
def _opened(name: str) -> "Iterator[Table]":
    """A table by path, or that of a shipped device."""
    from engine.table import Table, TableError
    from tactable.rig.ready import cached_table, open_cached
    from tactable.shipped import cache_folder, find_device, find_table, shipped_names

    if name in shipped_names() and not Path(name).exists():
        device = find_device(name)
        table = open_cached(device, cached_table(device, cache_folder()))
        if table is None:
            raise TableError(f"{name}: has no shipped table: build it by tactable build {name}, and name the file")
    else:
        table = Table.open(find_table(Path(name)))
    with table:
        yield table


def _say_stimuli(found: "Sequence[tuple[Task, Stimulus, Prediction]]", *, is_wanted: bool) -> float:
    """Say the strongest stimulus of each task where that is wanted; the greatest predicted acceleration, m/s^2."""
    from base.points import point_text

    for task, stimulus, predicted in found if is_wanted else ():
        hertz = "" if predicted.frequency_hz is None else f" of {predicted.frequency_hz:.0f} Hz"
        quiet = "" if predicted.quiet_db is None else f"; the other finger {predicted.quiet_db:.1f} dB"
        say(
            f"{task.name}: {task.finger_name(stimulus.finger)} at {point_text(task.position_m[stimulus.finger])} gets "
            f"at most {stimulus.level_db:g} dB by a {task.stimulus}{hertz}, {predicted.peak_m_per_s2:.1f} m/s^2{quiet}"
        )
    return max(predicted.peak_m_per_s2 for _, _, predicted in found)


def _say_precision(protocol: "Protocol", session: "Session") -> None:
    """Say how long the trials take, and how precise thresholds become by simulated observers."""
    from tactable.experiment.observer import half_widths
    from tactable.experiment.protocol import Kind

    seconds = sum(
        (_SECONDS[task.kind.has_intervals] + task.duration_s * (1 + task.kind.has_intervals))
        * (task.practice + task.catch + task.trials * len(task.position_m))
        for task in protocol.tasks
    )
    say(f"{session.total} trials, about {seconds / 60:.0f} min without breaks (ESTIMATE)")
    known: dict[object, dict[int, float]] = {}
    for task in protocol.tasks:
        if task.kind is Kind.FELT_AND_QUIET:
            continue
        key = (task.kind, task.levels_db, task.catch, task.practice)
        found = known[key] if key in known else known.setdefault(key, half_widths(task))
        words = ", ".join(f"{width:.1f} dB with {trials}" for trials, width in found.items())
        last, width = max(found.items())
        enough = next((trials for trials, each in found.items() if each <= 1), round(last * width**2, -1))
        say(f"{task.name}, trials of a track to half of the 95 % interval (SIMULATED): {words}; ± 1 dB: {enough:.0f}")


def _consent(protocol: "Protocol", session: "Session", peak_m_per_s2: float) -> str:
    return (
        f"{protocol.title}\n{session.total} questions about what your fingertips feel. Taking part is voluntary, and "
        "you may stop at any time, without a reason: press Stop, or lift your fingers. No stimulus exceeds "
        f"{peak_m_per_s2:.2g} m/s² under a fingertip (predicted). Answers are kept under a label, without your name."
    )


async def _ask(
    asked: "tuple[Protocol, Table, Session, SessionFiles]",
    consent: str,
    mark: "Mark",
    host: str,
    control_socket: Path | None,
    is_demo: bool,
) -> None:
    """Serve the page, and ask what is left. Raises ClientError and ExperimentError."""
    from base.files import work_folder
    from tactable.control.client import connect_async, default_socket
    from tactable.control.security import listen_at, new_token
    from tactable.experiment.conduct import Screen, conduct, serve_questions
    from tactable.experiment.stage import LiveStage, simulated_run
    from tactable.page.opening import announcement

    protocol, table, session, files = asked
    async with AsyncExitStack() as stack:
        path = control_socket or default_socket()
        stage_of: dict[str, Any] = {}
        if is_demo:
            remark("SIMULATED: fingers rest on a simulated device, and nothing is felt")
            path = control_socket or stack.enter_context(work_folder("control")) / "socket"
            stage_of["required"] = await stack.enter_async_context(simulated_run(table, path))
        client = await stack.enter_async_context(await connect_async(path, name="experiment"))
        stage = await LiveStage.on(client, protocol, table.device.name, **stage_of)
        stack.push_async_callback(stage.close)
        screen = Screen()
        listening, access = listen_at(host, 0, new_token())
        stack.enter_context(listening)
        for line in announcement(access):
            remark(line)
        await serve_questions(screen, listening, access, conduct(session, stage, screen, files, consent, mark))


def _report(
    protocol: "Protocol", table: "Table", files: "SessionFiles", participant: str, *, is_simulated: bool
) -> None:
    """Write report, picture and curve of the trials that are there, and say where."""
    from base.files import write_text
    from tactable.experiment.analysis import fit_of_rows
    from tactable.experiment.report import personal_curve, report_picture, report_text
    from tactable.experiment.session import Session
    from tactable.figures.picture_file import write_picture

    rows, _ = files.resume(Session(protocol, participant))
    fits = fit_of_rows(protocol, rows)
    if not any(fits):
        note("there are no trials yet that a report could show")
        return
    threshold = table.device.threshold
    simulated = "SIMULATED, nobody felt anything. " if is_simulated else ""
    text = f"{simulated}Device {table.device.name}; levels are dB above threshold {threshold.name}."
    title = f"Participant {participant}{' SIMULATED' if is_simulated else ''}"
    report, picture, curve = (files.path(name) for name in ("report.md", "report.png", "threshold.toml"))
    write_text(report, report_text(protocol, rows, fits, title, text).rstrip() + f"\n\n![answers]({picture.name})\n")
    write_picture(report_picture(*fits, f"{title}: {protocol.title}"), picture)
    written = personal_curve(fits[0], threshold, f"participant-{participant}", f"{title}, {len(rows)} trials. {text}")
    if written is not None:
        write_text(curve, written)
    OUT.print(report.read_text(encoding="utf-8").rstrip(), highlight=False, soft_wrap=True)
    say(f"written: {', '.join(str(path) for path in (report, picture, curve) if path != curve or written)}")
