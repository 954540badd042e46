"""What a process that was taken over can do: attempts from the inside, each with its control."""

from __future__ import annotations

import json
import os
import shutil
import socket
import subprocess
import sys
import tempfile
import textwrap
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from raykiln_service.executors.base import Outcome, OutcomeKind, Task
from raykiln_service.executors.limits import OWN_BYTES, Limits
from raykiln_service.executors.local import LocalExecutor
from raykiln_service.executors.nursery import Nursery
from raykiln_service.executors.process import JsonChild
from raykiln_service.planner import Unit
from raykiln_service.sandbox import LAYERS, Confinement, missing_layers

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="the sandbox needs Linux")

_NOBODY = 65534
_INSIDE = """
import ctypes, encodings.idna, os, resource, socket, subprocess, threading
from pathlib import Path
from raykiln_service.executors.childside import Channel
from raykiln_service.sandbox import Confinement, confine, kernel, seccomp

channel = Channel(listen=False)
task = channel.first()
if task["user"]:
    os.setgroups([])
    os.setgid(task["user"])
    os.setuid(task["user"])
    kernel.prctl(4, 1)  # A process that was started as this user can be dumped, too.
if task["before"] == "no capabilities":
    kernel.drop_capabilities()
if task["before"] == "no namespaces":
    kernel.forbid_new_privileges()
    seccomp.install()
report = None
if task["limits"] is not None:
    report = confine(Confinement.of(task["limits"]))
libc = ctypes.CDLL(None, use_errno=True)

def call(name, *arguments):
    if getattr(libc, name)(*arguments) < 0:
        raise OSError(ctypes.get_errno(), os.strerror(ctypes.get_errno()))

def tcp():
    socket.create_connection(("127.0.0.1", task["port"]), 5).close()

def udp():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as one:
        one.sendto(b"x", ("127.0.0.1", task["port"]))

def unix():
    with socket.socket(socket.AF_UNIX) as one:
        one.connect(task["socket"])

def spawn():
    subprocess.run(["/bin/true"], check=True)

def fork():
    pid = os.fork()
    if pid == 0:
        os._exit(0)
    os.waitpid(pid, 0)

def thread():
    one = threading.Thread(target=lambda: None)
    one.start()
    one.join()

def write(path):
    return lambda: Path(path).write_text("mine")

def big_file():
    with open(task["desk"] + "/big", "wb") as file:
        os.truncate(file.fileno(), 1 << 33)

other, own, desk = task["other"], task["own"], task["desk"]
ATTEMPTS = {
    "connect by TCP": tcp,
    "send by UDP": udp,
    "connect to a local socket": unix,
    "read the users": lambda: Path("/etc/passwd").read_text(),
    "read another job": lambda: Path(other).read_text(),
    "list another job": lambda: os.listdir(Path(other).parent),
    "read the environment of its parent": lambda: open(f"/proc/{os.getppid()}/environ").read(),
    "write beside another job": write(other + ".new"),
    "change the scene": write(own),
    "replace the scene": lambda: os.replace(desk + "/there", own),
    "write to the temporary folder": lambda: Path(task["temporary"]).write_text("x"),
    "change rights of the scene": lambda: os.chmod(own, 0o600),
    "change times of another job": lambda: os.utime(other),
    "link to another job": lambda: os.symlink(other, desk + "/link"),
    "make a pipe": lambda: os.mkfifo(desk + "/pipe"),
    "write a huge file": big_file,
    "start a program": spawn,
    "fork": fork,
    "signal the supervisor": lambda: os.kill(os.getppid(), 0),
    "limit the supervisor": lambda: resource.prlimit(os.getppid(), resource.RLIMIT_NOFILE),
    "be traced": lambda: call("ptrace", 0, 0, 0, 0),
    "stop sharing its folder": lambda: call("unshare", 0x200),
    "make a file without a name": lambda: os.memfd_create("x"),
    "hold more memory than allowed": lambda: bytearray(2 << 30),
}
ALLOWED = {
    "read the scene": lambda: Path(own).read_text(),
    "list the scene's folder": lambda: os.listdir(Path(own).parent),
    "write its own": write(desk + "/image.exr"),
    "replace its own": lambda: os.replace(desk + "/there", desk + "/again"),
    "make a folder of its own": lambda: os.mkdir(desk + "/more"),
    "start a thread": thread,
    "hold some memory": lambda: bytearray(1 << 28),
    "signal itself": lambda: os.kill(os.getpid(), 0),
    "load a module": lambda: __import__("colorsys"),
}
found = {}
Path(desk, "there").write_text("x")
for name, attempt in {**ALLOWED, **ATTEMPTS}.items():
    if name == "replace the scene":
        Path(desk, "there").write_text("x")
    try:
        attempt()
        found[name] = "done"
    except (OSError, MemoryError, ImportError) as error:
        found[name] = type(error).__name__
channel.send(report=report, found=found, allowed=list(ALLOWED))
"""


@pytest.fixture(scope="module")
def modules() -> Iterator[Path]:
    """A folder for modules that every user may enter, unlike pytest's own."""
    folder = Path(tempfile.mkdtemp(prefix="raykiln-sandbox-"))
    folder.chmod(0o755)
    yield folder
    shutil.rmtree(folder)


@pytest.fixture
def place() -> Iterator[Path]:
    """A folder of scenes and jobs that every user may enter."""
    folder = Path(tempfile.mkdtemp(prefix="raykiln-sandbox-"))
    for name in ("own", "other", "desk"):
        (folder / name).mkdir()
        (folder / name).chmod(0o777)
    for name in ("own", "other"):
        (folder / name / "scene.json").write_text("{}")
        (folder / name / "scene.json").chmod(0o666)
    folder.chmod(0o777)
    yield folder
    shutil.rmtree(folder)


@pytest.fixture(scope="module")
def nursery(modules: Path) -> Iterator[Nursery]:
    """Starts processes that find modules in the folder."""
    paths = [str(modules), *os.environ.get("PYTHONPATH", "").split(os.pathsep)]
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("PYTHONPATH", os.pathsep.join(os.path.abspath(p) for p in paths if p))
        # Programs that differ would else be taken for each other.
        patch.setenv("PYTHONDONTWRITEBYTECODE", "1")
        patch.setenv("RAYKILN_TOKEN", "a secret")
        started = Nursery()
        JsonChild("raykiln_service.executors.probe", launch=started.start).kill()
    yield started
    started.close()


@pytest.fixture
def attack(place: Path, modules: Path, nursery: Nursery) -> Callable[..., dict[str, Any]]:
    """Runs the attempts in a process, confined or not; what came of them."""
    (modules / "inside.py").write_text(textwrap.dedent(_INSIDE))

    def run(*, confined: bool = True, user: int = 0, before: str = "") -> dict[str, Any]:
        limits = Confinement(
            readable=(str(place / "own"),),
            writable=(str(place / "desk"),),
            memory_bytes=1 << 30,
            file_bytes=1 << 30,
        )
        with socket.create_server(("127.0.0.1", 0)) as tcp, socket.socket(socket.AF_UNIX) as unix:
            unix.bind(str(place / "socket"))
            (place / "socket").chmod(0o777)
            unix.listen()
            child = JsonChild("inside", launch=nursery.start)
            child.send(
                {
                    "limits": limits.as_dict() if confined else None,
                    "user": user,
                    "before": before,
                    "port": tcp.getsockname()[1],
                    "socket": str(place / "socket"),
                    "own": str(place / "own" / "scene.json"),
                    "other": str(place / "other" / "scene.json"),
                    "desk": str(place / "desk"),
                    "temporary": str(place / "temporary"),
                }
            )
            reply = child.receive(60.0)
            child.kill()
            assert reply, "\n".join(child.tail)
            return reply

    return run


def test_without_a_sandbox_the_attempts_succeed(attack: Callable[..., dict[str, Any]]) -> None:
    # The control: each attempt would work, were it not for the sandbox.
    assert {
        name for name, result in attack(confined=False)["found"].items() if result != "done"
    } == set()


@pytest.mark.parametrize(
    ("user", "before"),
    [(0, ""), (_NOBODY, ""), (0, "no capabilities"), (0, "no namespaces")],
    ids=["as it is", "another user", "no capabilities", "no namespaces"],
)
def test_nothing_can_be_done_from_inside(
    attack: Callable[..., dict[str, Any]], user: int, before: str
) -> None:
    if user and os.geteuid() != 0:
        pytest.skip("only root can become another user")
    reply = attack(user=user, before=before)
    assert list(reply["report"]) == list(LAYERS)
    assert missing_layers(reply["report"]) == {}
    in_namespace = "namespace" in reply["report"]["network"]
    assert in_namespace or before == "no namespaces" or os.geteuid() != 0
    done = {name for name, result in reply["found"].items() if result == "done"}
    # The interpreter may lie where another user does not get.
    unsure = {"load a module"} if user else set()
    assert done - unsure == set(reply["allowed"]) - unsure


def test_children_are_given_no_secrets(modules: Path, nursery: Nursery) -> None:
    (modules / "telltale.py").write_text(
        "import os\n"
        "from raykiln_service.executors.childside import Channel\n"
        "Channel().send(environment=dict(os.environ))\n"
    )
    child = JsonChild("telltale", launch=nursery.start)
    reply = child.receive(60.0)
    child.kill()
    assert reply is not None
    assert "PATH" in reply["environment"]
    assert [n for n, v in reply["environment"].items() if "RAYKILN" in n or "secret" in v] == []


_WAITS = """
import os, sys, time
from raykiln_service.executors.childside import Channel
channel = Channel(listen=False)
task = channel.first()
channel.confine(task)
channel.listen()
def tell(kind, **fields): channel.send(type=kind, token=task["token"], **fields)
"""


class Silent:
    """A watcher that wants nothing."""

    def progress(self, progress: Any) -> None: ...

    def preview(self) -> None: ...

    def log(self, line: str) -> None: ...

    def stop_reason(self) -> None:
        return None


@pytest.fixture
def render(place: Path, modules: Path, nursery: Nursery) -> Callable[..., Outcome]:
    """Runs a program as a render child of the real executor."""

    def run(program: str, limits: Limits, **task: Any) -> Outcome:
        (modules / "odd_renderer.py").write_text(_WAITS + textwrap.dedent(program))
        executor = LocalExecutor(
            1, module="odd_renderer", limits=limits, nursery=nursery, scratch=place / "scratch"
        )
        job = place / "job"
        (job / "work").mkdir(parents=True)
        try:
            return executor.run(
                0,
                Task(
                    job_id="job-1",
                    token="token-1",
                    unit=Unit(0),
                    scene_path=place / "own" / "scene.json",
                    base_dir=place / "own",
                    settings={},
                    outputs=("exr",),
                    work_dir=job / "work",
                    checkpoint=job / "checkpoint",
                    preview=job / "preview.png",
                    **task,
                ),
                Silent(),
            )
        finally:
            executor.stop()

    return run


def test_a_child_past_its_memory_is_ended(render: Callable[..., Outcome]) -> None:
    # By pages that the limit of data does not count.
    size = OWN_BYTES + (512 << 20)
    program = f"""
    import mmap
    held = mmap.mmap(-1, {size}, flags=mmap.MAP_PRIVATE | mmap.MAP_ANONYMOUS)
    for at in range(0, {size}, 4096): held[at] = 1
    time.sleep(60)
    """
    limits = Limits(memory_bytes=1 << 30)
    outcome = render(program, limits, memory_bytes=256 << 20)
    assert outcome.kind is OutcomeKind.REJECTED
    assert outcome.error["reason"] == "out-of-memory"
    assert "256 MiB" in outcome.error["detail"]


def test_a_child_that_runs_out_of_memory_says_so(render: Callable[..., Outcome]) -> None:
    size = OWN_BYTES + (2 << 30)
    outcome = render(f"held = bytearray({size})", Limits(memory_bytes=1 << 30))
    assert (outcome.kind, outcome.error["reason"]) == (OutcomeKind.REJECTED, "out-of-memory")


def test_a_silent_child_is_ended(render: Callable[..., Outcome]) -> None:
    program = "tell('progress', progress={'phase': 'render'}); time.sleep(60)"
    outcome = render(program, Limits(silence_s=0.5))
    assert (outcome.kind, outcome.error["reason"]) == (OutcomeKind.BROKEN, "stalled")


def test_a_child_that_loads_may_be_silent_for_longer(render: Callable[..., Outcome]) -> None:
    program = "time.sleep(2.5); tell('done', result={})"
    assert render(program, Limits(silence_s=1.0)).kind is OutcomeKind.DONE


@pytest.mark.parametrize("after", ["time.sleep(60)", "tell('stopped', result={'complete': False})"])
def test_a_task_ends_when_its_time_is_over(
    render: Callable[..., Outcome], place: Path, after: str
) -> None:
    program = f"""
    tell("progress", progress={{"phase": "render"}})
    while channel.stop_reason(task["token"]) != "timeout": time.sleep(0.01)
    open(task["work_dir"] + "/image.exr", "w").write("the image so far")
    tell("partial", result={{"complete": False}})
    {after}
    """
    # An image of before is worth waiting for, however late the child comes to say its first word.
    (place / "job").mkdir()
    (place / "job" / "checkpoint").write_text("of before")
    outcome = render(program, Limits(), time_left_s=0.3)
    assert outcome.kind is OutcomeKind.TIMED_OUT
    assert outcome.error["reason"] == "timeout"
    assert outcome.result == {"complete": False}
    assert (place / "job" / "work" / "image.exr").read_text() == "the image so far"


def test_only_finished_plain_files_are_taken(render: Callable[..., Outcome], place: Path) -> None:
    program = """
    out = task["work_dir"]
    open(out + "/image.exr", "w").write("good")
    open(out + "/.image.png.tmp", "w").write("half")
    os.mkdir(out + "/folder")
    os.symlink("/etc/passwd", out + "/passwd")
    os.mkfifo(out + "/pipe")
    open(task["checkpoint"], "w").write("a checkpoint")
    tell("checkpoint")
    tell("done", result={})
    """
    render(program, Limits(sandbox="off"))
    assert [path.name for path in (place / "job" / "work").iterdir()] == ["image.exr"]
    assert (place / "job" / "checkpoint").read_text() == "a checkpoint"


def test_the_checkpoint_of_a_child_that_crashes_is_kept(
    render: Callable[..., Outcome], place: Path
) -> None:
    (place / "job").mkdir()
    (place / "job" / "checkpoint").write_text("old")
    shutil.rmtree(place / "job" / "work", ignore_errors=True)
    program = """
    assert open(task["checkpoint"]).read() == "old"
    open(task["checkpoint"] + ".new", "w").write("new")
    os.replace(task["checkpoint"] + ".new", task["checkpoint"])
    os.abort()
    """
    assert render(program, Limits()).kind is OutcomeKind.BROKEN
    assert (place / "job" / "checkpoint").read_text() == "new"


_WITHOUT_LANDLOCK = """
import struct, sys, ctypes
from raykiln_service.sandbox import kernel
kernel.forbid_new_privileges()
lines = [
    (0x20, 0, 0, 0), (0x15, 0, 1, 444), (0x06, 0, 0, 0x00050000 | 38), (0x06, 0, 0, 0x7FFF0000)
]
code = b"".join(struct.pack("=HBBI", *line) for line in lines)
buffer = ctypes.create_string_buffer(code, len(code))
kernel.syscall(317, 1, 0, struct.pack("@HP", len(lines), ctypes.addressof(buffer)))
"""


@pytest.mark.skipif(os.uname().machine != "x86_64", reason="names its system calls by number")
@pytest.mark.parametrize("mode", ["auto", "require"])
def test_a_service_on_a_kernel_without_landlock(tmp_path: Path, mode: str) -> None:
    program = _WITHOUT_LANDLOCK + textwrap.dedent(
        """
            import json
            from pathlib import Path
            from raykiln_service.errors import StartupError
            from raykiln_service.service import Service
            from raykiln_service.settings import ServiceSettings
            try:
                service = Service(ServiceSettings.create(data_dir=Path(sys.argv[1])))
            except StartupError as error:
                print(json.dumps(str(error)))
            else:
                print(json.dumps(service.executor.sandbox_layers()))
                service.close()
            """
    )
    done = subprocess.run(
        [sys.executable, "-c", program, str(tmp_path / "data")],
        env={**os.environ, "RAYKILN_SANDBOX": mode},
        capture_output=True,
        text=True,
        timeout=120,
        check=True,
    )
    said = json.loads(done.stdout.splitlines()[-1])
    if mode == "require":
        assert "the sandbox is required and cannot be had here (files: " in said
    else:
        assert list(missing_layers(said)) == ["files"]
        assert "not implemented" in said["files"]
