"""The image is built and run: as a service, for one render and for a batch."""

from __future__ import annotations

import json
import os
import time
import uuid
from pathlib import Path

import httpx
import pytest
from engine import Engine, daemonless_engine, docker_engine, has_docker
from ports import free_port

pytestmark = [pytest.mark.slow, pytest.mark.timeout(1800)]


@pytest.fixture(scope="module")
def engine(repo_root: Path) -> Engine:
    """The image, built here and now."""
    if has_docker():
        return docker_engine(repo_root)
    tool = Path(os.environ.get("RAYKILN_SHARED", repo_root.parent / "shared")) / "tools/container"
    if not tool.is_file():
        pytest.skip("no docker daemon, and no daemonless container tool in the shared folder")
    if os.geteuid() != 0:
        pytest.skip("containers without a daemon need root here")
    return daemonless_engine(repo_root, tool, free_port())


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A folder that the container's user may write to."""
    path = tmp_path / "work"
    path.mkdir()
    path.chmod(0o777)
    return path


def wait_until_healthy(url: str) -> None:
    deadline = time.monotonic() + 60
    while True:
        try:
            httpx.get(f"{url}/healthz", timeout=60).raise_for_status()
            return
        except httpx.HTTPError:
            assert time.monotonic() < deadline, "the service never became healthy"
            time.sleep(0.2)


def test_serves_jobs_to_those_with_the_token(engine: Engine) -> None:
    port, name = free_port(), f"raykiln-{uuid.uuid4().hex}"
    url = f"http://127.0.0.1:{port}"
    job = {"scene": {"name": "cornell_box"}, "settings": {"width": 32, "height": 32, "spp": 4}}
    options = ("-e", f"PORT={port}", "-e", "RAYKILN_TOKEN=a-token-for-this-test")
    with engine.service(name, *options):
        wait_until_healthy(url)
        assert httpx.post(f"{url}/v1/jobs", json=job, timeout=60).status_code == 401
        with httpx.Client(
            base_url=url, headers={"Authorization": "Bearer a-token-for-this-test"}, timeout=90
        ) as client:
            done = client.post("/v1/jobs", json=job, headers={"Prefer": "wait=60"}).json()
            assert done["state"] == "succeeded", done
            image = client.get(f"/v1/jobs/{done['id']}/outputs/image.exr")
            assert image.content.startswith(b"\x76\x2f\x31\x01")


def test_makes_a_token_when_none_is_given(engine: Engine, folder: Path) -> None:
    port, name = free_port(), f"raykiln-{uuid.uuid4().hex}"
    url = f"http://127.0.0.1:{port}"
    with engine.service(name, "-e", f"PORT={port}", "-v", f"{folder}:/data"):
        wait_until_healthy(url)
        assert httpx.get(f"{url}/v1/jobs", timeout=60).status_code == 401
        # The token's file is for the container's user only.
        look = ["-v", f"{folder}:/data", "--entrypoint", "cat"]
        token = engine.run("/data/token", options=look).stdout.strip()
        assert len(token) >= 32
        assert token not in engine.logs(name)
        headers = {"Authorization": f"Bearer {token}"}
        assert httpx.get(f"{url}/v1/jobs", headers=headers, timeout=60).status_code == 200


def test_health_check_tells_a_service_from_none(engine: Engine) -> None:
    port, name = free_port(), f"raykiln-{uuid.uuid4().hex}"
    check = ["--entrypoint", "healthcheck", "-e", f"PORT={port}"]
    assert engine.run(options=check).returncode == 1
    with engine.service(name, "-e", f"PORT={port}"):
        wait_until_healthy(f"http://127.0.0.1:{port}")
        assert engine.run(options=check).returncode == 0


def test_renders_one_scene(engine: Engine, folder: Path) -> None:
    done = engine.run(
        *("render", "cornell_box", "--spp", "4", "--size", "48x32"),
        *("-o", "box.exr", "-o", "box.png", "--stats", "stats.json"),
        options=["-v", f"{folder}:/work"],
    )
    assert done.returncode == 0, done.stderr
    assert (folder / "box.exr").read_bytes().startswith(b"\x76\x2f\x31\x01")
    assert (folder / "box.png").read_bytes().startswith(b"\x89PNG")
    assert json.loads((folder / "stats.json").read_text())["samples"] == 4 * 48 * 32


def test_renders_a_batch(engine: Engine, folder: Path) -> None:
    scenes = folder / "scenes"
    scenes.mkdir()
    (scenes / "bad.json").write_text('{"version": 1')
    manifest = folder / "list.txt"
    manifest.write_text("cornell_box\nwhitted_spheres\n")
    options = ["-v", f"{folder}:/work"]
    size = ("--spp", "2", "--size", "32x32")

    good = engine.run("batch", "list.txt", "-o", "out", *size, options=options)
    assert good.returncode == 0, good.stderr
    assert len(list((folder / "out").rglob("*.exr"))) == 2

    bad = engine.run("batch", "scenes", "-o", "out-bad", *size, options=options)
    assert bad.returncode == 1
    assert "bad.json" in (folder / "out-bad" / "report.json").read_text()


def test_refuses_bad_usage(engine: Engine) -> None:
    done = engine.run("render", "no_such_scene.json", "-o", "/tmp/out.png")
    assert done.returncode == 2
    assert "no_such_scene.json" in done.stderr
    assert "Traceback" not in done.stderr


def test_holds_no_build_tools_and_no_root(engine: Engine) -> None:
    look = "id -u; command -v gcc g++ cc cmake ninja pip make; dpkg-query -Wf '${Package}\\n'"
    done = engine.run("-c", look, options=["--entrypoint", "sh"])
    user, *rest = done.stdout.split()
    assert user != "0"
    assert "python3" in rest
    assert [line for line in rest if line.startswith("/") or line.endswith("-dev")] == []
