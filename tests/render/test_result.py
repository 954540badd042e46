"""What a render returns: shapes, statistics, and files that say where they come from."""

from __future__ import annotations

import json
import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import raykiln as rk
from raykiln.image import read_exr_layers, read_exr_metadata, read_image

from .bit_scene import bit_scene

STATISTICS = {
    "queue_s", "load_s", "bvh_s", "render_s", "denoise_s", "encode_s", "total_s", "samples", "spp",
    "camera_rays", "bounce_rays", "shadow_rays", "rays_per_s", "peak_memory_bytes", "triangles",
    "threads", "isa", "nonfinite_samples", "engine_version", "scene_sha256",
    "warm",
}  # fmt: skip


class TestResult:
    @pytest.fixture
    def result(self) -> rk.RenderResult:
        settings = rk.RenderSettings(
            width=40, height=24, spp=8, seed=3, aovs=("albedo", "normal", "depth", "variance")
        )
        return rk.render(bit_scene(), settings)

    def test_shapes_and_kinds(self, result: rk.RenderResult) -> None:
        shapes = {name: layer.shape for name, layer in result.aovs.items()}
        assert shapes == {
            "albedo": (24, 40, 3),
            "normal": (24, 40, 3),
            "depth": (24, 40),
            "variance": (24, 40),
        }
        for layer in (result.image, *result.aovs.values()):
            assert layer.dtype == np.float32
            assert np.isfinite(layer).all()
        assert np.linalg.norm(result.aovs["normal"], axis=-1).max() <= 1 + 1e-5
        assert result.aovs["depth"].max() > 1
        assert result.aovs["variance"].min() >= 0

    def test_statistics_are_complete_and_consistent(self, result: rk.RenderResult) -> None:
        stats = result.stats.as_dict()
        assert set(stats) >= STATISTICS
        assert stats["samples"] == stats["camera_rays"] == 40 * 24 * 8
        assert stats["spp"] == 8
        assert stats["bounce_rays"] > 0
        assert stats["shadow_rays"] > 0
        rays = stats["camera_rays"] + stats["bounce_rays"] + stats["shadow_rays"]
        assert stats["rays_per_s"] == pytest.approx(rays / stats["render_s"])
        assert stats["total_s"] >= stats["load_s"] + stats["bvh_s"] + stats["render_s"] * 0.9
        assert stats["peak_memory_bytes"] > 1 << 20
        assert stats["threads"] >= 1
        assert stats["nonfinite_samples"] == 0
        assert stats["engine_version"] == rk.__version__
        assert len(stats["scene_sha256"]) == 64
        json.dumps(stats)

    def test_exr_has_the_layers_and_says_where_it_comes_from(
        self, result: rk.RenderResult, tmp_path: Path
    ) -> None:
        path = result.save(tmp_path / "out.exr")
        layers = read_exr_layers(path)
        np.testing.assert_array_equal(read_image(path)[..., :3], result.image)
        for name, layer in result.aovs.items():
            stored = {key.lower(): value for key, value in layers.items()}
            key = name if name in stored else {"normal": "n"}.get(name, name)
            np.testing.assert_array_equal(np.squeeze(stored[key]), layer)
        metadata = read_exr_metadata(path)
        assert metadata["raykiln:scene_sha256"] == result.scene_sha256
        assert json.loads(str(metadata["raykiln:settings"]))["spp"] == 8
        assert int(metadata["raykiln:seed"]) == 3
        assert metadata["raykiln:engine_version"] == rk.__version__
        assert result.stats.encode_s > 0

    def test_same_bits_make_the_same_files(self, result: rk.RenderResult, tmp_path: Path) -> None:
        again = rk.render(bit_scene(), result.settings.model_copy(update={"threads": 1}))
        for name in ("out.exr", "out.png"):
            one = result.save(tmp_path / f"a-{name}").read_bytes()
            assert one == again.save(tmp_path / f"b-{name}").read_bytes()

    def test_half_is_near(self, result: rk.RenderResult, tmp_path: Path) -> None:
        path = result.save(tmp_path / "half.exr", half=True)
        np.testing.assert_allclose(read_image(path)[..., :3], result.image, rtol=1e-3, atol=1e-6)

    @pytest.mark.parametrize("view", ["srgb", "agx", "aces", "raw"])
    def test_png_by_view(self, result: rk.RenderResult, tmp_path: Path, view: Any) -> None:
        dark = read_image(result.save(tmp_path / "a.png", view=view))
        bright = read_image(result.save(tmp_path / "b.png", view=view, exposure=1.0))
        assert dark.shape == (24, 40, 3)
        assert bright.mean() > dark.mean()

    def test_unknown_extension(self, result: rk.RenderResult, tmp_path: Path) -> None:
        with pytest.raises(rk.ImageError, match=r"\.bmp.*accepted: \.exr, \.png"):
            result.save(tmp_path / "out.bmp")
        assert not list(tmp_path.iterdir())

    def test_a_missing_folder(self, result: rk.RenderResult, tmp_path: Path) -> None:
        with pytest.raises(rk.ImageError, match="nowhere"):
            result.save(tmp_path / "nowhere" / "out.png")


def test_a_denoised_result_keeps_the_noisy_image(tmp_path: Path) -> None:
    pytest.importorskip("pyoidn", reason="the denoiser is not installed")
    plain = rk.RenderSettings(width=32, height=24, spp=2)
    noisy = rk.render(bit_scene(), plain).image
    result = rk.render(bit_scene(), plain.model_copy(update={"denoise": True}))
    assert np.array_equal(result.aovs["noisy"], noisy)
    assert not np.array_equal(result.image, noisy)
    layers = read_exr_layers(result.save(tmp_path / "denoised.exr"))
    assert set(layers) == {"beauty", "noisy"}


def test_the_file_of_a_crop_says_where_it_lies(tmp_path: Path) -> None:
    settings = rk.RenderSettings(width=40, height=24, spp=1, crop=(8, 4, 20, 20))
    file = rk.render(bit_scene(), settings).save(tmp_path / "crop.exr")
    assert read_exr_layers(file)["beauty"].shape == (16, 12, 3)
    # The windows as the format has them: corners, the last pixel included.
    header = file.read_bytes()
    for name, corners in (("dataWindow", (8, 4, 19, 19)), ("displayWindow", (0, 0, 39, 23))):
        attribute = f"{name}\0box2i\0".encode() + struct.pack("<i", 16)
        start = header.index(attribute) + len(attribute)
        assert struct.unpack("<4i", header[start : start + 16]) == corners
