"""Render children of the real service: warm scenes, memory, time, hangs, cancel at any state."""

from __future__ import annotations

import io
import os
import signal
import struct
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from raykiln import denoise
from raykiln.image import read_exr_layers, read_image
from raykiln_service.executors.limits import OWN_BYTES

SMALL: dict[str, Any] = {"width": 48, "height": 32, "spp": 8, "threads": 1}
ENDLESS: dict[str, Any] = {"width": 64, "height": 48, "spp": 1 << 20, "threads": 1}


def children(server: Any) -> list[int]:
    """Process ids of the render children."""
    found, parents = [], {}
    for entry in Path("/proc").glob("[0-9]*"):
        try:
            name, fields = (entry / "stat").read_text().split("(", 1)[1].rsplit(")", 1)
        except (OSError, IndexError):
            continue
        parents[int(entry.name)] = int(fields.split()[1])
        if name == "raykiln-child" and fields.split()[0] != "Z":
            found.append(int(entry.name))
    return [pid for pid in found if parents.get(parents[pid]) == server.process.pid]


def done(server: Any, **body: Any) -> dict[str, Any]:
    """A job once it has ended; never answered from the cache of results."""
    job: dict[str, Any] = server.wait_for_end(server.submit(cache=False, **body)["id"])
    return job


def pixels(server: Any, job: dict[str, Any]) -> dict[str, bytes]:
    layers = read_exr_layers(server.output(job["id"], "image.exr"))
    return {name: layer.tobytes() for name, layer in layers.items()}


def large_scene(count: int) -> bytes:
    """An OBJ file of `count` triangles, slow enough to read that one can step in."""
    rng = np.random.default_rng(1)
    text = io.StringIO()
    np.savetxt(text, rng.random((count, 3)), fmt="v %.6f %.6f %.6f")
    corners = rng.integers(1, count + 1, (count, 3))
    np.savetxt(text, corners, fmt="f %d %d %d")
    return text.getvalue().encode()


def upload(server: Any, content: bytes, name: str) -> str:
    with server.client() as client:
        reply = client.post("/v1/assets", params={"filename": name}, content=content)
        asset: str = reply.raise_for_status().json()["id"]
        return asset


class TestWarm:
    def test_a_second_job_finds_the_scene_loaded(self, server: Any, ball: Any) -> None:
        scene = {"inline": {**ball, "name": "warm"}}
        cold = done(server, scene=scene, settings=SMALL)
        warm = done(server, scene=scene, settings=SMALL)
        other = done(server, scene=scene, settings={**SMALL, "width": 20, "seed": 3})
        assert [job["stats"]["warm"] for job in (cold, warm, other)] == [False, True, True]
        assert cold["stats"]["bvh_s"] > 0
        assert warm["stats"]["load_s"] == warm["stats"]["bvh_s"] == 0
        assert pixels(server, warm) == pixels(server, cold)
        alone = done(server, scene={"inline": {**ball, "name": "w"}}, settings=other["settings"])
        assert not alone["stats"]["warm"]
        assert pixels(server, alone) == pixels(server, other)

    def test_another_scene_gets_another_process(self, server: Any, ball: Any) -> None:
        done(server, scene={"inline": {**ball, "name": "one"}}, settings=SMALL)
        before = set(children(server))
        again = done(server, scene={"inline": {**ball, "name": "one"}}, settings=SMALL)
        assert again["stats"]["warm"]
        assert set(children(server)) == before
        done(server, scene={"inline": {**ball, "name": "two"}}, settings=SMALL)
        assert len(set(children(server)) - before) == 1

    def test_only_so_many_stay(self, serve: Any, ball: Any) -> None:
        server = serve(warm_scenes=2)
        for name in "abc":
            done(server, scene={"inline": {**ball, "name": name}}, settings=SMALL)
        assert len(children(server)) == 2
        assert done(server, scene={"inline": {**ball, "name": "b"}}, settings=SMALL)["stats"][
            "warm"
        ]
        first = done(server, scene={"inline": {**ball, "name": "a"}}, settings=SMALL)
        assert not first["stats"]["warm"]

    def test_none_stays_past_the_memory_for_it(self, serve: Any, ball: Any) -> None:
        server = serve(warm_memory_bytes=0)
        done(server, scene={"inline": ball}, settings=SMALL)
        assert children(server) == []
        assert not done(server, scene={"inline": ball}, settings=SMALL)["stats"]["warm"]

    def test_a_child_that_died_in_its_sleep_is_replaced(self, server: Any, ball: Any) -> None:
        scene = {"inline": {**ball, "name": "sleeper"}}
        before = set(children(server))
        done(server, scene=scene, settings=SMALL)
        for pid in set(children(server)) - before:
            os.kill(pid, signal.SIGKILL)
        job = done(server, scene=scene, settings=SMALL)
        assert (job["state"], job["attempts"], job["stats"]["warm"]) == ("succeeded", 1, False)

    def test_cameras_of_one_scene_share_it(self, server: Any, ball: Any) -> None:
        scene = {"inline": {**ball, "name": "turning"}}
        job = done(server, scene=scene, settings=SMALL, frames={"turntable": {"count": 3}})
        assert job["state"] == "succeeded"
        with server.client() as client:
            frames = client.get(f"/v1/jobs/{job['id']}/frames").raise_for_status().json()["items"]
        assert [frame["stats"]["warm"] for frame in frames] == [False, True, True]


def too_large() -> dict[str, Any]:
    """Settings of an image that needs 700 MB more than a process may take for itself."""
    side = 1 << 10
    while 12 * side * side < OWN_BYTES + 700_000_000:
        side += 1 << 10
    return {"width": side, "height": side, "spp": 1}


class TestMemory:
    def test_a_job_that_needs_too_much_fails_alone(self, server: Any, ball: Any) -> None:
        large = {**too_large(), "aovs": ["albedo", "normal"]}
        job = done(server, scene={"inline": ball}, settings=large, memory_bytes=1 << 28)
        assert (job["state"], job["attempts"]) == ("failed", 1)
        assert job["error"]["reason"] == "out-of-memory"
        assert "256 MiB" in job["error"]["detail"]
        assert done(server, scene={"inline": ball}, settings=SMALL)["state"] == "succeeded"

    def test_the_service_allows_no_more_than_its_own_limit(self, serve: Any, ball: Any) -> None:
        server = serve(job_memory_bytes=1 << 27)
        job = done(server, scene={"inline": ball}, settings=too_large(), memory_bytes=1 << 40)
        assert job["error"]["reason"] == "out-of-memory"
        assert "128 MiB" in job["error"]["detail"]

    def test_a_scene_that_is_too_large_is_refused(self, serve: Any) -> None:
        server = serve(check_memory_bytes=1 << 26)
        asset = upload(server, large_scene(600_000 * OWN_BYTES // (288 << 20)), "large.obj")
        with server.client() as client:
            reply = client.post("/v1/jobs", json={"scene": {"asset": asset}})
        assert reply.status_code == 422
        assert reply.json()["detail"] == "the scene needs more memory than a check may use"


class TestTime:
    def test_a_job_past_its_time_fails_with_its_image(self, server: Any, ball: Any) -> None:
        # Loaded before, so that the time goes into the image on a slow machine too.
        done(server, scene={"inline": ball}, settings=SMALL)
        job = done(server, scene={"inline": ball}, settings=ENDLESS, timeout_s=3.0)
        assert (job["state"], job["attempts"]) == ("failed", 1)
        assert (job["error"]["reason"], job["complete"]) == ("timeout", False)
        layers = read_exr_layers(server.output(job["id"], "image.exr"))
        assert layers["beauty"].shape == (48, 64, 3)
        assert layers["beauty"].mean() > 0
        assert job["stats"]["spp"] >= 1

    def test_the_service_has_a_limit_of_its_own(self, serve: Any, ball: Any) -> None:
        server = serve(max_job_s=1.0)
        job = done(server, scene={"inline": ball}, settings=ENDLESS, timeout_s=1e6)
        assert job["error"]["reason"] == "timeout"

    def test_time_used_is_remembered(self, serve: Any, ball: Any) -> None:
        server = serve(heartbeat_s=0.1, checkpoint_interval_s=0.0)
        job_id = server.submit(scene={"inline": ball}, settings=ENDLESS, timeout_s=900.0)["id"]
        before = server.wait_for(
            job_id,
            lambda view: view["used_s"] >= 1.0 and (view["progress"]["spp_done"] or 0) >= 8,
        )
        server.kill_all()
        limit = before["used_s"] + 2.0
        server = serve(heartbeat_s=0.1, checkpoint_interval_s=0.0, max_job_s=limit)
        assert server.job(job_id)["used_s"] >= before["used_s"]
        job = server.wait_for_end(job_id)
        assert (job["error"]["reason"], job["attempts"]) == ("timeout", 2)
        assert job["stats"]["spp"] > 0
        with server.client() as client:
            again = client.post(f"/v1/jobs/{job_id}/retry").raise_for_status().json()
            assert again["used_s"] == 0
            client.post(f"/v1/jobs/{job_id}/cancel").raise_for_status()
        server.wait_for_end(job_id)

    def test_a_job_whose_time_is_over_at_once_keeps_its_image(self, serve: Any, ball: Any) -> None:
        server = serve(heartbeat_s=0.1, checkpoint_interval_s=0.0)
        job_id = server.submit(scene={"inline": ball}, settings=ENDLESS)["id"]
        server.wait_for(job_id, lambda view: (view["progress"]["spp_done"] or 0) >= 8)
        server.wait_for(job_id, lambda view: view["used_s"] >= 0.5)
        server.kill_all()
        server = serve(max_job_s=0.1)
        job = server.wait_for_end(job_id)
        assert (job["error"]["reason"], job["complete"]) == ("timeout", False)
        assert job["stats"]["spp"] >= 1

    def test_a_child_that_hangs_is_one_lost_attempt(self, serve: Any, ball: Any) -> None:
        server = serve(silence_timeout_s=3.0)
        job_id = server.submit(scene={"inline": ball}, settings=ENDLESS)["id"]
        server.wait_for(job_id, lambda view: (view["progress"]["spp_done"] or 0) >= 2)
        (pid,) = children(server)
        os.kill(pid, signal.SIGSTOP)
        server.wait_for(job_id, lambda view: view["attempts"] == 2)
        with server.client() as client:
            client.post(f"/v1/jobs/{job_id}/cancel").raise_for_status()
        server.wait_for_end(job_id)
        assert "said nothing for 3 s" in server.output(job_id, "log.txt").decode()
        assert pid not in children(server)


class TestCancel:
    """What is asked for is that it happens there, and leaves nothing behind."""

    @staticmethod
    def cancel_in(server: Any, phase: str, **body: Any) -> dict[str, Any]:
        ended = ("succeeded", "failed", "cancelled")
        # A job may be through with it before anybody could step in: then the next one.
        for _ in range(10):
            job_id = server.submit(cache=False, **body)["id"]
            view = server.wait_for(
                job_id, lambda view: view["progress"]["phase"] == phase or view["state"] in ended
            )
            if view["state"] not in ended:
                # Whoever has nothing worth keeping yet is killed, also while it is held.
                held = children(server) if phase == "load" else []
                for pid in held:
                    os.kill(pid, signal.SIGSTOP)
                is_there = server.job(job_id)["progress"]["phase"] == phase
                with server.client() as client:
                    client.post(f"/v1/jobs/{job_id}/cancel")
                for pid in [] if is_there else held:
                    os.kill(pid, signal.SIGCONT)
                job: dict[str, Any] = server.wait_for_end(job_id)
                if is_there and job["state"] == "cancelled":
                    return job
            server.wait_for_end(job_id)
        raise AssertionError(f"no job could be cancelled in the phase {phase}")

    @staticmethod
    def was_hurried(exr: bytes) -> bool:
        """Whether the image was written as it is: compressing it would keep somebody waiting."""
        head = b"compression\0compression\0" + struct.pack("<i", 1)
        return exr[exr.index(head) + len(head)] == 0

    def test_while_a_large_scene_is_loaded(self, serve: Any) -> None:
        server = serve(warm_scenes=0)
        asset = upload(server, large_scene(300_000), "large.obj")
        job = self.cancel_in(server, "load", scene={"asset": asset}, settings=SMALL)
        assert job["complete"] is None
        assert job["outputs"] == []
        assert children(server) == []

    def test_while_it_renders(self, server: Any, ball: Any) -> None:
        job = self.cancel_in(server, "render", scene={"inline": ball}, settings=ENDLESS)
        assert job["complete"] is False
        image = server.output(job["id"], "image.exr")
        assert read_exr_layers(image)["beauty"].mean() > 0
        assert self.was_hurried(image)

    @pytest.mark.skipif(not denoise.available(), reason="the denoiser is not installed")
    def test_while_it_denoises(self, server: Any, ball: Any) -> None:
        settings = {"width": 1536, "height": 1536, "spp": 1, "denoise": True}
        job = self.cancel_in(server, "denoise", scene={"inline": ball}, settings=settings)
        assert job["complete"] is False
        image = server.output(job["id"], "image.exr")
        assert self.was_hurried(image)
        layers = read_exr_layers(image)
        # The image is there as it was before denoising.
        assert layers["beauty"].shape == (1536, 1536, 3)
        assert "noisy" not in layers

    def test_while_it_writes(self, server: Any, ball: Any) -> None:
        settings = {"width": 2048, "height": 1536, "spp": 1, "aovs": ["albedo", "depth"]}
        job = self.cancel_in(server, "encode", scene={"inline": ball}, settings=settings)
        assert "image.exr" in [output["name"] for output in job["outputs"]]
        layers = read_exr_layers(server.output(job["id"], "image.exr"))
        assert sorted(layers) == ["albedo", "beauty", "depth"]
        with server.client() as client:
            # Also where the time did not suffice to make it before.
            picture = client.get(f"/v1/jobs/{job['id']}/outputs/image.png").raise_for_status()
        assert read_image(picture.content).shape == (1536, 2048, 3)


def test_nothing_is_left_on_the_desks(serve: Any, ball: Any) -> None:
    server = serve()
    done(server, scene={"inline": ball}, settings=SMALL)
    desks = list((server.data_dir / "tmp").glob("desk-*"))
    assert len(desks) == 1
    assert list(desks[0].iterdir()) == []
    assert server.stop() == 0
    assert list((server.data_dir / "tmp").glob("desk-*")) == []
    deadline = time.monotonic() + 60
    while children(server):
        assert time.monotonic() < deadline
        time.sleep(0.02)


def test_the_service_tells_what_confines_its_children(serve: Any, server: Any) -> None:
    with server.client() as client:
        layers = client.get("/v1/version").json()["sandbox"]
    assert set(layers) == {"privileges", "limits", "network", "files", "system_calls"}
    with serve(env={"RAYKILN_SANDBOX": "off"}, warm_scenes=0).client() as client:
        assert client.get("/v1/version").json()["sandbox"] == {}
