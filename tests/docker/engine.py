"""Building and running containers: docker with its daemon, or the shared daemonless stand-in."""

from __future__ import annotations

import os
import shutil
import subprocess
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

IMAGE = os.environ.get("IMAGE", "localhost/raykiln:test")

# Hides the cgroup tree, which runtimes without a daemon cannot use everywhere.
_WITHOUT_CGROUPS = 'mount -t tmpfs -o ro cgroup /sys/fs/cgroup && exec "$@"'


class Engine:
    """How containers are run here; every run has a read-only root and no capabilities."""

    def __init__(self, command: Sequence[str], run_options: Sequence[str]) -> None:
        self._command = list(command)
        self._run = [*command, "run", "--read-only", "--cap-drop", "all", "--network", "host"]
        self._run += run_options

    def run(
        self, *arguments: str, options: Sequence[str] = (), timeout_s: float = 300
    ) -> subprocess.CompletedProcess[str]:
        """Run the image once with `arguments`; the container is gone afterwards."""
        return subprocess.run(
            [*self._run, "--rm", *options, IMAGE, *arguments],
            capture_output=True,
            text=True,
            timeout=timeout_s,
            check=False,
            stdin=subprocess.DEVNULL,
        )

    @contextmanager
    def service(self, name: str, *options: str) -> Iterator[None]:
        """The image with its default command, until the block ends; the stop must be clean."""
        self._call([*self._run, "-d", "--name", name, *options, IMAGE])
        try:
            yield
            self._call([*self._command, "stop", "-t", "10", name])
        except BaseException:
            print(self.logs(name))
            raise
        finally:
            subprocess.run([*self._command, "rm", "-f", name], capture_output=True, check=False)

    def logs(self, name: str) -> str:
        """What a container has written so far."""
        command = [*self._command, "logs", name]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        return done.stdout + done.stderr

    @staticmethod
    def _call(command: Sequence[str]) -> str:
        done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=120)
        assert done.returncode == 0, f"{command}: {done.stderr}"
        return done.stdout


def has_docker() -> bool:
    """Whether a docker daemon answers."""
    if shutil.which("docker") is None:
        return False
    return subprocess.run(["docker", "info"], capture_output=True, check=False).returncode == 0


def docker_engine(repo_root: Path) -> Engine:
    """Build with docker."""
    build = ["docker", "build", "-q", "-f", "docker/Dockerfile", "-t", IMAGE, "."]
    subprocess.run(build, cwd=repo_root, check=True, stdin=subprocess.DEVNULL)
    return Engine(["docker"], ["--tmpfs", "/tmp"])


def daemonless_engine(repo_root: Path, tool: Path, port: int) -> Engine:
    """Build with the shared tool, which also runs the default command and waits for its health."""
    work = os.environ.get("WORK", "/var/tmp/raykiln-container")
    settings = {
        "CONTEXT": str(repo_root),
        "DOCKERFILE": "docker/Dockerfile",
        "IMAGE": IMAGE,
        "PORT": str(port),
        "WORK": work,
    }
    done = subprocess.run(
        [tool],
        env={**os.environ, **settings},
        capture_output=True,
        text=True,
        check=False,
        stdin=subprocess.DEVNULL,
    )
    assert done.returncode == 0, done.stdout[-4000:] + done.stderr[-4000:]
    podman = ["podman", "--root", f"{work}/storage", "--runroot", f"{work}/run"]
    podman += ["--storage-driver", os.environ.get("DRIVER", "overlay"), "--runtime", "crun"]
    podman += ["--cgroup-manager", "cgroupfs", "--events-backend", "none", "--log-level", "error"]
    private = ["unshare", "-m", "--propagation", "private", "sh", "-c", _WITHOUT_CGROUPS, "sh"]
    limits = ["--ulimit", "nofile=4096:4096", "--ulimit", "nproc=4096:4096"]
    return Engine([*private, *podman], ["--cgroups=disabled", *limits])
