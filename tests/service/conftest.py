"""A store to test alone, and the real service in a process of its own."""

from __future__ import annotations

import json
import os
import secrets
import shutil
import signal
import struct
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import httpx
import pytest
import sqlalchemy as sa
from ports import free_port
from raykiln_service.database import Database
from raykiln_service.store import Store

_SERVE = (
    "import json, sys; from raykiln_service.app import serve; "
    "from raykiln_service.settings import ServiceSettings; "
    "serve(ServiceSettings.create(**json.loads(sys.argv[1])))"
)


class Clock:
    """A clock that stands until it is set."""

    def __init__(self) -> None:
        self.ms = 1_000_000

    def __call__(self) -> int:
        return self.ms


@pytest.fixture
def clock() -> Clock:
    """The clock of `store`."""
    return Clock()


@pytest.fixture(scope="session")
def postgres() -> Iterator[str]:
    """The URL of a PostgreSQL server that lives as long as the tests, without a database."""
    pytest.importorskip("psycopg", reason="the PostgreSQL driver is not installed")
    programs = sorted(Path("/usr/lib/postgresql").glob("*/bin"))
    if not programs:
        pytest.skip("no PostgreSQL server is installed")
    # Not in pytest's folder, which only its owner may enter.
    with tempfile.TemporaryDirectory(prefix="raykiln-postgres-") as name:
        folder = Path(name)
        as_user: list[str] = []
        if os.geteuid() == 0:
            # The server refuses to run as root.
            as_user = ["runuser", "-u", "postgres", "--"]
            shutil.chown(folder, "postgres")
        port = free_port()

        def run(program: str, *arguments: str) -> None:
            command = [*as_user, str(programs[-1] / program), "-D", str(folder / "data")]
            subprocess.run(
                [*command, *arguments],
                check=True,
                cwd="/",
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
            )

        options = f"-c listen_addresses=127.0.0.1 -p {port} -c unix_socket_directories={folder}"
        # No test pulls the plug of this server.
        options += " -c fsync=off -c full_page_writes=off"
        run("initdb", "-A", "trust", "--no-sync", "-U", "postgres")
        run("pg_ctl", "-w", "-l", str(folder / "log"), "-o", options, "start")
        yield f"postgresql+psycopg://postgres@127.0.0.1:{port}"
        run("pg_ctl", "-w", "-m", "immediate", "stop")


@contextmanager
def _postgres_database(postgres: str, template: str = "template1") -> Iterator[str]:
    name = f"test_{secrets.token_hex(6)}"
    server = sa.create_engine(f"{postgres}/postgres", isolation_level="AUTOCOMMIT")
    with server.connect() as connection:
        connection.execute(sa.text(f"CREATE DATABASE {name} TEMPLATE {template}"))
    yield f"{postgres}/{name}"
    with server.connect() as connection:
        connection.execute(sa.text(f"DROP DATABASE {name} WITH (FORCE)"))
    server.dispose()


@pytest.fixture
def postgres_url(postgres: str) -> Iterator[str]:
    """The URL of an empty PostgreSQL database."""
    with _postgres_database(postgres) as url:
        yield url


@pytest.fixture(scope="session")
def postgres_template(postgres: str) -> Iterator[str]:
    """The name of a PostgreSQL database with all tables, to be copied."""
    with _postgres_database(postgres) as url:
        _migrate(url)
        yield url.rpartition("/")[2]


@pytest.fixture(scope="session")
def sqlite_template(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An SQLite file with all tables, to be copied."""
    path = tmp_path_factory.mktemp("template") / "jobs.db"
    _migrate(Database.sqlite_url(path))
    # All is in the one file that is copied.
    assert not path.with_name("jobs.db-wal").exists()
    return path


def _migrate(url: str) -> None:
    database = Database(url)
    database.migrate()
    database.close()


@pytest.fixture(params=["sqlite", "postgresql"])
def store(request: pytest.FixtureRequest, tmp_path: Path, clock: Clock) -> Iterator[Store]:
    """An empty store in a new database, of each kind."""
    if request.param == "sqlite":
        yield request.getfixturevalue("sqlite_store")
        return
    postgres = request.getfixturevalue("postgres")
    with _postgres_database(postgres, request.getfixturevalue("postgres_template")) as url:
        database = Database(url)
        yield Store(database, clock=clock)
        database.close()


@pytest.fixture
def sqlite_store(sqlite_template: Path, tmp_path: Path, clock: Clock) -> Iterator[Store]:
    """An empty store in a new SQLite database."""
    shutil.copy(sqlite_template, tmp_path / "jobs.db")
    database = Database(Database.sqlite_url(tmp_path / "jobs.db"))
    yield Store(database, clock=clock)
    database.close()


@dataclass
class Server:
    """A service in a process group of its own."""

    process: subprocess.Popen[str]
    url: str
    data_dir: Path
    log: Path
    headers: dict[str, str] = field(default_factory=dict)

    def client(self) -> httpx.Client:
        """A plain HTTP client of it."""
        return httpx.Client(base_url=self.url, timeout=60.0, headers=self.headers)

    def submit(self, **body: Any) -> dict[str, Any]:
        """Submit a job; what the service says of it."""
        with self.client() as client:
            reply = client.post("/v1/jobs", json=body)
            assert reply.status_code == 202, reply.text
            view: dict[str, Any] = reply.json()
            return view

    def job(self, job_id: str) -> dict[str, Any]:
        """A job as it is now."""
        with self.client() as client:
            view: dict[str, Any] = client.get(f"/v1/jobs/{job_id}").raise_for_status().json()
            return view

    def wait_for(
        self, job_id: str, reached: Callable[[dict[str, Any]], bool], within_s: float = 120.0
    ) -> dict[str, Any]:
        """The job as soon as it looks as wanted."""
        deadline = time.monotonic() + within_s
        while not reached(view := self.job(job_id)):
            assert time.monotonic() < deadline, f"waited in vain; last: {view}"
            time.sleep(0.02)
        return view

    def wait_for_end(self, job_id: str) -> dict[str, Any]:
        """The job once it has ended."""
        ended = ("succeeded", "failed", "cancelled")
        return self.wait_for(job_id, lambda view: view["state"] in ended)

    def output(self, job_id: str, name: str) -> bytes:
        """The bytes of an output."""
        with self.client() as client:
            return client.get(f"/v1/jobs/{job_id}/outputs/{name}").raise_for_status().content

    def kill_all(self) -> None:
        """End the service without any warning (SIGKILL to its process group)."""
        os.killpg(self.process.pid, signal.SIGKILL)
        self.process.wait()

    def stop(self) -> int:
        """End the service as an init system does; its exit code."""
        self.process.terminate()
        return self.process.wait(timeout=60)


class Starter:
    """Starts services, and ends them all."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._started: list[Server] = []

    def __call__(self, *, env: dict[str, str] | None = None, **settings: Any) -> Server:
        """Start a service; without `data_dir` each start is on the same data folder."""
        data_dir = Path(settings.setdefault("data_dir", str(self._folder / "data")))
        settings.setdefault("port", 0)
        log = self._folder / f"service-{len(self._started)}.log"
        with log.open("w") as errors:
            process = subprocess.Popen(
                [sys.executable, "-c", _SERVE, json.dumps(settings)],
                stdout=subprocess.PIPE,
                stderr=errors,
                text=True,
                start_new_session=True,
                env={**os.environ, **(env or {})},
            )
        assert process.stdout is not None
        line = process.stdout.readline()
        if "serving on" not in line:
            process.kill()
            process.wait()
            process.stdout.close()
            pytest.fail(f"the service did not start: {log.read_text()}")
        server = Server(process, line.split()[-1], data_dir, log)
        if "token" in settings:
            server.headers["Authorization"] = f"Bearer {settings['token']}"
        self._started.append(server)
        return server

    def latest(self) -> Server:
        """The service that was started last."""
        return self._started[-1]

    def close(self) -> None:
        """End all that still run."""
        for server in self._started:
            if server.process.poll() is None:
                server.kill_all()
            assert server.process.stdout is not None
            server.process.stdout.close()


@pytest.fixture
def serve(tmp_path: Path) -> Iterator[Starter]:
    """Starts services: `serve(**settings)`."""
    starter = Starter(tmp_path)
    yield starter
    starter.close()


@pytest.fixture(scope="module")
def module_serve(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Starter]:
    """The same, for services that the tests of a module share."""
    starter = Starter(tmp_path_factory.mktemp("service"))
    yield starter
    starter.close()


@pytest.fixture(scope="module")
def server(module_serve: Starter) -> Server:
    """One service for a module's tests."""
    return module_serve()


@pytest.fixture(scope="session")
def ball() -> dict[str, Any]:
    """A small scene in the native format: a red ball on a floor under a lamp."""
    return {
        "version": 1,
        "name": "ball",
        "cameras": [
            {
                "type": "perspective",
                "name": "front",
                "look_at": {"origin": [0, 1, 4], "target": [0, 0.5, 0]},
            }
        ],
        "materials": {
            "red": {"type": "diffuse", "reflectance": [0.7, 0.2, 0.1]},
            "floor": {"type": "diffuse", "reflectance": 0.6},
        },
        "shapes": [
            {"type": "sphere", "center": [0, 0.7, 0], "radius": 0.7, "material": "red"},
            {
                "type": "rectangle",
                "material": "floor",
                "transform": [[5, 0, 0, 0], [0, 0, 5, 0], [0, -5, 0, 0], [0, 0, 0, 1]],
            },
            {"type": "sphere", "center": [2, 3, 2], "radius": 0.4, "emission": {"radiance": 12}},
        ],
    }


def _animated(target: str, path: str, values: list[list[float]]) -> bytes:
    """A GLB of a triangle before a camera; one property of one of them is animated over 2 s."""
    triangle = struct.pack("<9f", -1, -1, 0, 1, -1, 0, 0, 1, 0)
    count = len(values)
    times = struct.pack(f"<{count}f", *(2 * i / (count - 1) for i in range(count)))
    moves = struct.pack(f"<{3 * len(values)}f", *(x for row in values for x in row))
    views, binary = [], b""
    for part in (triangle, times, moves):
        views.append({"buffer": 0, "byteOffset": len(binary), "byteLength": len(part)})
        binary += part
    kinds = [("VEC3", 3), ("SCALAR", len(values)), ("VEC3", len(values))]
    document = {
        "asset": {"version": "2.0"},
        "scenes": [{"nodes": [0, 1]}],
        "nodes": [{"mesh": 0}, {"camera": 0, "translation": [0, 0, 4]}],
        "cameras": [{"type": "perspective", "perspective": {"yfov": 0.8, "znear": 0.1}}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}],
        "buffers": [{"byteLength": len(binary)}],
        "bufferViews": views,
        "accessors": [
            {"bufferView": i, "componentType": 5126, "count": count, "type": kind}
            for i, (kind, count) in enumerate(kinds)
        ],
        "animations": [
            {
                "samplers": [{"input": 1, "output": 2}],
                "channels": [
                    {
                        "sampler": 0,
                        "target": {"node": ["mesh", "camera"].index(target), "path": path},
                    }
                ],
            }
        ],
    }
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    chunks = struct.pack("<II", len(text), 0x4E4F534A) + text
    chunks += struct.pack("<II", len(binary), 0x004E4942) + binary
    return struct.pack("<III", 0x46546C67, 2, 12 + len(chunks)) + chunks


@pytest.fixture(scope="session")
def moving() -> bytes:
    """A GLB with a triangle that moves to the right for 2 s."""
    return _animated("mesh", "translation", [[0, 0, 0], [1, 0, 0]])


@pytest.fixture(scope="session")
def vanishing() -> bytes:
    """A GLB whose camera shrinks to nothing after 1 s, where it cannot see, and grows again."""
    return _animated("camera", "scale", [[1, 1, 1], [0, 0, 0], [1, 1, 1]])
