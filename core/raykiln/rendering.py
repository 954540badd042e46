"""Rendering: passes until the samples are taken, with progress, cancel and checkpoints."""

from __future__ import annotations

import queue
import re
import resource
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from raykiln import _core
from raykiln import checkpoint as checkpoints
from raykiln import denoise as denoising
from raykiln.compile import CompiledScene, PreparedScene, compile_scene
from raykiln.errors import SettingsError
from raykiln.result import Pixels, RenderResult, RenderStats
from raykiln.scene import Scene
from raykiln.settings import RenderSettings

# A noise estimate from fewer samples is itself noise.
MIN_SPP_FOR_NOISE = 16
_ASK_S = 0.02


@dataclass(frozen=True)
class Progress:
    """How far a render is.

    Attributes
    ----------
    fraction
        0 to 1.
    spp_done, spp
        Samples that every pixel has, and will have.
    samples
        Camera samples over all pixels so far.
    elapsed_s, eta_s
        Seconds of rendering, and an estimate of those to come (None at first).
    preview
        Call it for the image so far: float32 (height, width, 3), linear.
    """

    fraction: float
    spp_done: int
    spp: int
    samples: int
    elapsed_s: float
    eta_s: float | None
    preview: Callable[[], Pixels]


OnProgress = Callable[[Progress], bool | None]


@dataclass(frozen=True)
class SceneReport:
    """What a scene holds once everything in it was found and built."""

    triangles: int
    spheres: int
    instances: int
    lights: int
    materials: int
    textures: int
    cameras: list[str]
    bounds: tuple[tuple[float, float, float], tuple[float, float, float]]
    memory_bytes: int
    """Of the bounding volume hierarchies."""
    scene_sha256: str
    settings: dict[str, Any]
    """Of the render, as the scene has them."""
    warnings: list[str]

    def summary(self) -> dict[str, Any]:
        """The report as plain values, for JSON."""
        return dict(self.__dict__)


def check(scene: Scene, settings: RenderSettings | None = None) -> SceneReport:
    """Build a scene without rendering it: raises `SceneError` at the first bad place."""
    resolved = (settings or RenderSettings()).over(scene.settings)
    compiled = compile_scene(scene, resolved)
    return SceneReport(
        **compiled.core.summary(),
        cameras=[camera.name for camera in scene.cameras],
        bounds=compiled.core.bounds(),
        memory_bytes=compiled.core.memory_bytes,
        scene_sha256=compiled.sha256,
        settings=resolved.model_dump(mode="json"),
        warnings=compiled.warnings,
    )


def render(
    scene: Scene | PreparedScene,
    settings: RenderSettings | None = None,
    on_progress: OnProgress | None = None,
    *,
    checkpoint: str | Path | None = None,
    resume: bool = False,
    checkpoint_interval_s: float = 5.0,
) -> RenderResult:
    """Render a scene.

    Parameters
    ----------
    scene
        From `load_scene`, built in code, or made ready for several renders by `prepare`.
    settings
        Fields left unset are taken from the scene, then from the defaults.
    on_progress
        Called at the end of each pass, and more than ten times a second within it, from this
        thread; return False to stop: what was rendered by then is returned, with `complete` False.
        Also called while denoising, with all samples done: stopped there, the image stays noisy.
    checkpoint
        A file to keep the state in: written at the end of a pass when `checkpoint_interval_s`
        seconds went by since the last time, and when the render stops early.
    resume
        Go on from `checkpoint` if it exists. The bits are those of an undisturbed render.

    Raises
    ------
    SceneError, SettingsError
        The scene or the settings cannot be rendered.
    RenderError
        The checkpoint is damaged or of another render, or memory ran out.
    KeyboardInterrupt
        Ctrl-C arrived; the checkpoint was written.
    """
    start = time.perf_counter()
    given = settings or RenderSettings()
    resolved = given.over((scene.scene if isinstance(scene, PreparedScene) else scene).settings)
    if resume and checkpoint is None:
        raise SettingsError("resume: needs a checkpoint file to resume from")
    if resolved.denoise:
        denoising.require()
    compiled = _compiled(scene, resolved)
    job = _Job(compiled, resolved, on_progress)
    if checkpoint is not None:
        job.keep(Path(checkpoint), checkpoint_interval_s, resume)
    complete = job.run()
    result = job.result(complete)
    if resolved.denoise:
        _denoise(result, job.ask, keep=resolved.aovs)
    result.stats.total_s = time.perf_counter() - start
    return result


def _compiled(scene: Scene | PreparedScene, settings: RenderSettings) -> CompiledScene:
    if isinstance(scene, PreparedScene):
        return scene.view(settings)
    return compile_scene(scene, settings)


class _Job:
    """One render from its first pass to its last."""

    def __init__(
        self, compiled: CompiledScene, settings: RenderSettings, on_progress: OnProgress | None
    ) -> None:
        self.compiled = compiled
        self.settings = settings
        self.on_progress = on_progress
        x0, y0, x1, y1 = settings.crop or (0, 0, settings.width, settings.height)
        self.pixels = (x1 - x0) * (y1 - y0)
        self.renderer = _core.Renderer(compiled.core, self._options((x0, y0, x1, y1)))
        self.checkpoint: Path | None = None
        self.checkpoint_interval_s = 0.0
        self.earlier: dict[str, Any] = {}
        self.samples = 0
        self.started = time.perf_counter()
        self.saved = self.started

    def _options(self, crop: tuple[int, int, int, int]) -> dict[str, Any]:
        s = self.settings
        layers = {*s.aovs, *(("albedo", "normal") if s.denoise else ())}
        names = ("width", "height", "spp", "seed", "threads", "filter", "integrator")
        return {
            **{name: getattr(s, name) for name in (*names, "sampler", "max_depth", "rr_depth")},
            **{name: name in layers for name in ("albedo", "normal", "depth")},
            "crop": crop,
        }

    def keep(self, path: Path, interval_s: float, resume: bool) -> None:
        """Keep the state in a file, and start from it if it is there and `resume` is set."""
        self.checkpoint, self.checkpoint_interval_s = path, interval_s
        if resume and path.exists():
            self.earlier = checkpoints.load(path, self.renderer, self._identity())
            self.samples = int(self.renderer.planes()["counts"].sum(dtype=np.int64))

    def _identity(self) -> dict[str, Any]:
        """What decides the bits: a checkpoint serves only a render with the same."""
        free = {"threads", "time_budget_s", "noise_threshold"}
        return {
            "scene": self.compiled.sha256,
            "engine": _core.__version__,
            "isa": isa(),
            **self.settings.model_dump(mode="json", exclude=free),
        }

    def run(self) -> bool:
        """Render; returns False if it was stopped. A due checkpoint is written even then."""
        self.started = self.saved = time.perf_counter()
        try:
            while not self.renderer.finished:
                if not self.renderer.run_pass(self._poll):
                    break
                if self._quiet_enough():
                    return True
                if time.perf_counter() - self.saved >= self.checkpoint_interval_s:
                    self._save()
                # Every pass is reported, however short: there a caller can stop for certain.
                done = self.renderer.samples_done
                if done < self.settings.spp and not self._poll(self.pixels * done):
                    break
        except BaseException:
            self._save()
            raise
        if self.renderer.finished:
            self._poll(self.pixels * self.settings.spp)
            return True
        self._save()
        return self._over_budget()

    def _poll(self, samples: int) -> bool:
        self.samples = samples
        # The first pass is always finished: without it there is no image.
        if self._over_budget() and self.renderer.samples_done:
            return False
        return self.ask()

    def ask(self) -> bool:
        """Report the progress; False if the caller wants an end."""
        return self.on_progress is None or self.on_progress(self._progress()) is not False

    def _over_budget(self) -> bool:
        budget = self.settings.time_budget_s
        return budget is not None and time.perf_counter() - self.started >= budget

    def _quiet_enough(self) -> bool:
        threshold = self.settings.noise_threshold
        if threshold is None or self.renderer.samples_done < MIN_SPP_FOR_NOISE:
            return False
        error = np.sqrt(self._variance())
        return bool(np.mean(error / (_luminance(self._image()) + 0.01)) < threshold)

    def _progress(self) -> Progress:
        total = self.pixels * self.settings.spp
        elapsed = time.perf_counter() - self.started
        before = self.earlier.get("samples", 0)
        fresh = self.samples - before
        eta = elapsed * (total - self.samples) / fresh if fresh > 0 else None
        return Progress(
            fraction=self.samples / total,
            spp_done=self.renderer.samples_done,
            spp=self.settings.spp,
            samples=self.samples,
            elapsed_s=elapsed + self.earlier.get("render_s", 0.0),
            eta_s=eta,
            preview=self._image,
        )

    def _work(self) -> dict[str, Any]:
        """Work done in all, that before a resume included."""
        work: dict[str, Any] = dict(self.renderer.counts())
        work["render_s"] = time.perf_counter() - self.started
        for name, value in self.earlier.items():
            work[name] = work.get(name, 0) + value
        # Counted by the film itself.
        work["samples"] = int(self.renderer.planes()["counts"].sum(dtype=np.int64))
        return work

    def _save(self) -> None:
        if self.checkpoint is not None:
            checkpoints.save(self.checkpoint, self.renderer, self._identity(), self._work())
        self.saved = time.perf_counter()

    def _image(self) -> Pixels:
        planes = self.renderer.planes()
        return _mean(planes["radiance"], planes["counts"])

    def _variance(self) -> Pixels:
        """Of each pixel's mean luminance, as if the samples were independent."""
        planes = self.renderer.planes()
        count = np.maximum(planes["counts"], 1).astype(np.float32)
        mean = _luminance(self._image())
        spread = np.maximum(planes["luminance_squared"] / count - mean * mean, 0)
        variance: Pixels = (spread / np.maximum(count - 1, 1)).astype(np.float32)
        return variance

    def _aovs(self) -> dict[str, Pixels]:
        planes = self.renderer.planes()
        aovs: dict[str, Pixels] = {}
        for name in ("albedo", "normal"):
            if name in planes:
                aovs[name] = _mean(planes[name], planes["counts"])
        if "depth" in planes:
            aovs["depth"] = _mean(planes["depth"], planes["depth_weight"])
        if "variance" in self.settings.aovs:
            aovs["variance"] = self._variance()
        return aovs

    def result(self, complete: bool) -> RenderResult:
        work = self._work()
        rays = work["camera_rays"] + work["bounce_rays"] + work["shadow_rays"]
        stats = RenderStats(
            load_s=self.compiled.load_s,
            bvh_s=self.compiled.bvh_s,
            **work,
            spp=self.renderer.samples_done,
            rays_per_s=rays / work["render_s"] if work["render_s"] > 0 else 0.0,
            peak_memory_bytes=_peak_memory_bytes(),
            triangles=self.compiled.core.summary()["triangles"],
            threads=self.renderer.threads,
            isa=isa(),
            engine_version=_core.__version__,
            scene_sha256=self.compiled.sha256,
            warm=self.compiled.warm,
        )
        return RenderResult(
            self._image(),
            self._aovs(),
            stats,
            self.settings,
            list(self.compiled.warnings),
            complete,
        )


def _mean(sums: Any, counts: Any) -> Pixels:
    """Sums over counts; 0 where there are none."""
    divisor = np.maximum(counts, 1).astype(np.float32)
    if sums.ndim == 3:
        divisor = divisor[..., None]
    mean: Pixels = (sums / divisor).astype(np.float32)
    return mean


def _luminance(image: Pixels) -> Pixels:
    # Not a matrix product: its order of adding, and so its bits, would depend on the image's size.
    red, green, blue = np.float32(0.212671), np.float32(0.715160), np.float32(0.072169)
    luminance: Pixels = image[..., 0] * red + image[..., 1] * green + image[..., 2] * blue
    return luminance


def _denoise(result: RenderResult, ask: Callable[[], bool], keep: tuple[str, ...]) -> None:
    start = time.perf_counter()
    noisy = result.image
    denoised = None
    if result.complete:
        denoised = _denoised(noisy, result.aovs["albedo"], result.aovs["normal"], ask)
    result.aovs = {name: layer for name, layer in result.aovs.items() if name in keep}
    if denoised is None:
        result.complete = False
    else:
        result.image = denoised
        # So that one can compare, and blend the two.
        result.aovs["noisy"] = noisy
    result.stats.denoise_s = time.perf_counter() - start


def _denoised(
    image: Pixels, albedo: Pixels, normal: Pixels, ask: Callable[[], bool]
) -> Pixels | None:
    """The denoised image, or None if `ask` said to stop; the denoiser itself cannot be stopped."""
    outcome: queue.SimpleQueue[Pixels | BaseException] = queue.SimpleQueue()

    def work() -> None:
        try:
            outcome.put(denoising.denoise(image, albedo, normal))
        except BaseException as error:
            outcome.put(error)

    threading.Thread(target=work, daemon=True).start()
    while True:
        try:
            found = outcome.get(timeout=_ASK_S)
        except queue.Empty:
            if not ask():
                return None
            continue
        if isinstance(found, BaseException):
            raise found
        return found


def _peak_memory_bytes() -> int:
    """Greatest resident size of this process so far.

    Not by `getrusage`: what that counts begins with the size of the parent.
    """
    try:
        status = Path("/proc/self/status").read_text()
    except OSError:
        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
    return int(re.findall(r"VmHWM:\s+(\d+)", status)[0]) * 1024


def isa() -> str:
    """The instruction set that the bits depend on."""
    return _core.isa()
