"""The commands that talk to a service: submit, list, status, download, cancel."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from raykiln_service.commands.console import (
    CommandError,
    check_writable,
    print_json,
    print_note,
    print_warnings,
    usage_error,
)
from raykiln_service.commands.downloads import Target, download_all, download_targets
from raykiln_service.commands.frames import FrameOptions
from raykiln_service.commands.gc import BYTES, quantity
from raykiln_service.commands.limits import (
    MemoryOption,
    TimeoutOption,
    WebhookEventOption,
    WebhookOption,
    webhook_of,
)
from raykiln_service.commands.options import RenderOptions, with_options, with_render_options
from raykiln_service.commands.render import (
    ExposureOption,
    QuietOption,
    StatsOption,
    ViewOption,
    check_view,
)
from raykiln_service.commands.scenes import BaseDirOption, SceneArgument, resolve_scene
from raykiln_service.commands.watch import (
    JobArgument,
    JsonOption,
    ServerOption,
    WatchReporter,
    conclude,
    wait_or_leave,
)

if TYPE_CHECKING:
    from raykiln_service.client import Client, Job

LabelOption = Annotated[
    list[str] | None, typer.Option("--label", help="Label; may repeat.", metavar="KEY=VALUE")
]
AnimationOption = Annotated[
    list[str] | None,
    typer.Option(
        "--animation", help="Make an animation of the frames, too; may repeat.", metavar="webp|mp4"
    ),
]


@with_options(FrameOptions, "frames")
@with_render_options
def submit(
    *,
    scene: SceneArgument,
    server: ServerOption = None,
    wait: Annotated[bool, typer.Option("--wait", help="Watch the job until it ends.")] = False,
    output: Annotated[
        list[Path] | None,
        typer.Option(
            "--output",
            "-o",
            help="Download to this .exr, .png or .json (statistics) file, or folder; may repeat; "
            "implies --wait.",
            metavar="OUT",
        ),
    ] = None,
    stats: StatsOption = None,
    exposure: ExposureOption = 0.0,
    view: ViewOption = "srgb",
    base_dir: BaseDirOption = None,
    priority: Annotated[
        int, typer.Option("--priority", help="Higher ones go first.", metavar="N")
    ] = 0,
    label: LabelOption = None,
    timeout: TimeoutOption = None,
    memory: MemoryOption = None,
    webhook: WebhookOption = None,
    webhook_event: WebhookEventOption = None,
    no_cache: Annotated[
        bool, typer.Option("--no-cache", help="Render even if an identical job's result is there.")
    ] = False,
    animation: AnimationOption = None,
    as_json: JsonOption = False,
    quiet: QuietOption = False,
    frames: FrameOptions,
    options: RenderOptions,
) -> None:
    """Submit a scene to a service; prints the job's id.

    Of many pictures each file gets its number in place of ####, or before its extension.

    Files that the scene reads are uploaded with it. Ctrl-C while waiting asks whether to cancel
    the job or leave it running.
    """
    from raykiln_service.client import Client

    check_view(view, exposure)
    settings = options.settings().model_dump(mode="json", exclude_unset=True)
    labels = parse_labels(label)
    request = frames.request()
    outputs = outputs_of(animation, request)
    hook = webhook_of(webhook, webhook_event)
    memory_bytes = quantity("--memory", memory, BYTES, "512M or 4G")
    targets = download_targets(output or [])
    if stats is not None:
        check_writable(stats, "--stats")
        targets.append(Target(stats, "stats.json"))
    with Client(server) as client:
        spec = _upload(client, scene, base_dir)
        job = client.submit(
            spec,
            settings,
            frames=request,
            outputs=outputs,
            priority=priority,
            labels=labels,
            timeout_s=timeout,
            memory_bytes=memory_bytes,
            webhook=hook,
            cache=not no_cache,
        )
        if not quiet:
            print_warnings(job.warnings)
        waiting = wait or bool(targets)
        if not waiting:
            _show_submitted(job, client, as_json=as_json, quiet=quiet)
            return
        if not quiet:
            print_note(f"submitted {job.id} to {client.server}")
        job = wait_or_leave(client, job, WatchReporter(quiet=quiet or as_json))
        if as_json:
            print_json(job.model_dump(mode="json"))
        conclude(job, quiet=quiet or as_json)
        for path in download_all(client, job, targets, exposure=exposure, view=view):
            if not (quiet or as_json):
                print(path)


def _upload(client: Client, scene: str, base_dir: Path | None) -> dict[str, Any]:
    """What the job is to render: a bundled name, or an asset that is uploaded now."""
    from raykiln import bundled_scenes

    from raykiln_service.client import package

    path = resolve_scene(scene)
    if scene in bundled_scenes() and not Path(scene).is_file():
        return {"name": scene}
    try:
        with package(path, base_dir) as packed:
            asset = client.upload_asset(packed.path)
            return {"asset": asset.id, "entry": packed.entry}
    except ValueError as error:
        raise CommandError(str(error)) from None


def _show_submitted(job: Job, client: Client, *, as_json: bool, quiet: bool) -> None:
    if as_json:
        print_json(job.model_dump(mode="json"))
        return
    print(job.id)
    if not quiet:
        print_note(f"follow it with: raykiln watch {job.id} --server {client.server}")


def parse_labels(texts: list[str] | None) -> dict[str, str]:
    """The labels of texts such as ``project=demo``."""
    labels = {}
    for text in texts or []:
        key, equals, value = text.partition("=")
        if not equals or not key:
            raise usage_error("--label", "not a label", found=text, accepted="KEY=VALUE")
        labels[key] = value
    return labels


def outputs_of(animations: list[str] | None, frames: dict[str, Any] | None) -> list[str] | None:
    """The outputs to ask for; None = what the service makes by itself."""
    if not animations:
        return None
    for name in animations:
        if name not in ("webp", "mp4"):
            raise usage_error("--animation", "no such kind", found=name, accepted="webp, mp4")
    if frames is None:
        raise usage_error("--animation", "goes with many pictures only", accepted="--turntable N")
    return ["exr", "png", "contact_sheet", *dict.fromkeys(animations)]


def status(job: JobArgument, server: ServerOption = None, as_json: JsonOption = False) -> None:
    """Show where a job stands."""
    from raykiln_service.client import Client

    with Client(server) as client:
        found = client.job(job)
    if as_json:
        print_json(found.model_dump(mode="json"))
        return
    print(_line(found))
    if found.error_text:
        print(f"error: {found.error_text}")
    print_warnings(found.warnings)


def list_jobs(
    server: ServerOption = None,
    state: Annotated[
        str | None,
        typer.Option(
            "--state",
            help="Only jobs in this state.",
            metavar="queued|running|succeeded|failed|cancelled",
        ),
    ] = None,
    label: LabelOption = None,
    limit: Annotated[int, typer.Option("--limit", help="At most this many.", metavar="N")] = 20,
    as_json: JsonOption = False,
) -> None:
    """List jobs, newest first."""
    from raykiln_service.client import Client

    if limit < 1:
        raise usage_error("--limit", "out of range", found=limit, accepted="1 up")
    jobs: list[Job] = []
    cursor = None
    with Client(server) as client:
        while len(jobs) < limit:
            page = client.jobs(
                state=state,
                labels=parse_labels(label),
                limit=min(100, limit - len(jobs)),
                cursor=cursor,
            )
            jobs += page.items
            cursor = page.next_cursor
            if cursor is None:
                break
    if as_json:
        print_json([job.model_dump(mode="json") for job in jobs])
        return
    for job in jobs:
        print(_line(job))


def _line(job: Job) -> str:
    text = f"{job.id}  {job.state:<9}"
    if job.state == "queued" and job.queue_position is not None:
        text += f"  position {job.queue_position}"
    elif job.state == "running":
        text += f"  {job.progress.fraction:4.0%}"
    if job.frames is not None:
        text += f"  {job.frames.succeeded}/{job.frames.count} frames"
        text += f", {job.frames.failed} failed" if job.frames.failed else ""
    labels = ", ".join(f"{key}={value}" for key, value in job.labels.items())
    return f"{text}  {labels}".rstrip()


def retry(job: JobArgument, server: ServerOption = None, as_json: JsonOption = False) -> None:
    """Run a failed or cancelled job again; it goes on from its last checkpoint."""
    from raykiln_service.client import Client

    with Client(server) as client:
        _show(client.retry(job), as_json=as_json)


def delete(job: JobArgument, server: ServerOption = None) -> None:
    """Remove a job that has ended, with its results."""
    from raykiln_service.client import Client

    with Client(server) as client:
        client.delete(job)


def _show(job: Job, *, as_json: bool) -> None:
    if as_json:
        print_json(job.model_dump(mode="json"))
    else:
        print(_line(job))


def cancel(job: JobArgument, server: ServerOption = None, as_json: JsonOption = False) -> None:
    """Cancel a job; what it has rendered so far is kept."""
    from raykiln_service.client import Client

    with Client(server) as client:
        _show(client.cancel(job), as_json=as_json)
