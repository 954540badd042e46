"""The one command `raykiln`: names the commands and turns every failure into one line."""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Sequence
from gc import freeze
from types import FrameType
from typing import Annotated, NoReturn

import typer

from raykiln_service.commands import (
    batch,
    compare,
    deliveries,
    downloads,
    gc,
    queue,
    remote,
    render,
    scenes,
    serve,
    token,
    watch,
)
from raykiln_service.commands.console import CommandError, ExitCode, print_error

app = typer.Typer(
    name="raykiln",
    help="Render scenes here or on a raykiln service.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["--help", "-h"]},
)
app.command()(render.render)
app.command()(batch.batch)
app.command()(scenes.inspect)
app.command()(compare.compare)
app.command()(scenes.scenes)
app.command()(serve.serve)
app.command()(remote.submit)
app.command("list")(remote.list_jobs)
app.command()(remote.status)
app.command()(watch.watch)
app.command()(downloads.download)
app.command()(remote.cancel)
app.command()(remote.retry)
app.command()(remote.delete)
app.command()(deliveries.deliveries)
app.command()(queue.queue)
app.command()(gc.gc)
app.add_typer(token.app, name="token")


def _print_version(wanted: bool) -> None:
    if wanted:
        from importlib.metadata import PackageNotFoundError, version

        try:
            print(f"raykiln {version('raykiln')}")
        except PackageNotFoundError:
            import raykiln

            print(f"raykiln {raykiln.__version__}")
        raise typer.Exit


@app.callback()
def _common(
    version: Annotated[
        bool,
        typer.Option(
            "--version", help="Show the version and exit.", callback=_print_version, is_eager=True
        ),
    ] = False,
) -> None:
    """Render scenes here or on a raykiln service."""


def run(arguments: Sequence[str] | None = None) -> int:
    """Run one command line; returns its exit code, and never raises but for `SystemExit`."""
    try:
        code = app(arguments, prog_name="raykiln", standalone_mode=False)
    except typer.TyperException as error:
        print_error(_usage_text(error.format_message()))
        return ExitCode.USAGE
    except CommandError as error:
        print_error(str(error))
        return error.exit_code
    except (KeyboardInterrupt, typer.Abort):
        return ExitCode.INTERRUPTED
    except MemoryError:
        print_error("out of memory")
        return ExitCode.FAILED
    except Exception as error:
        return _failure(error)
    return code if isinstance(code, int) else ExitCode.DONE


def _usage_text(message: str) -> str:
    """A usage error of the parser, in the house's form ``where: what``."""
    head = "Invalid value for "
    if message.startswith(head):
        where, _, what = message.removeprefix(head).partition(": ")
        return f"{where.replace(chr(39), '')}: {what}"
    return message


def _failure(error: Exception) -> int:
    code = _exit_code_of(error)
    if code is not None:
        print_error(str(error))
        return code
    if os.environ.get("RAYKILN_DEBUG"):
        raise error
    kind = type(error).__name__
    print_error(f"unexpected {kind}: {error} (RAYKILN_DEBUG=1 shows the traceback)")
    return ExitCode.FAILED


def _exit_code_of(error: Exception) -> int | None:
    """The exit code for an error raised on purpose.

    A module that is not loaded cannot have raised: looking at what is loaded spares the imports.
    """
    core = sys.modules.get("raykiln.errors")
    if core is not None and isinstance(error, core.RaykilnError):
        return ExitCode.FAILED if isinstance(error, core.RenderError) else ExitCode.USAGE
    client = sys.modules.get("raykiln_service.client.models")
    if client is not None and isinstance(error, client.ClientError):
        refused = isinstance(error, client.ServerError)
        busy = refused and (error.status >= 500 or error.status == 429)
        return ExitCode.FAILED if busy else ExitCode.USAGE
    service = sys.modules.get("raykiln_service.errors")
    if service is not None and isinstance(error, service.StartupError):
        return ExitCode.USAGE
    return None


def _interrupt(number: int, frame: FrameType | None) -> NoReturn:
    raise KeyboardInterrupt


def main() -> NoReturn:
    """Entry point of the console script."""
    signal.signal(signal.SIGTERM, _interrupt)
    code = run()
    # Leaving, the interpreter would look for cycles among all that there is.
    freeze()
    sys.exit(code)


if __name__ == "__main__":
    main()
