// Numbers, times and names as people read them.

export const FINAL_STATES = new Set(["succeeded", "failed", "cancelled"]);
export const STATES = ["queued", "running", "succeeded", "failed", "cancelled"];

export function bytes(count) {
  if (count < 1000) return `${count} B`;
  const units = ["kB", "MB", "GB", "TB"];
  let value = count / 1000;
  while (value >= 999.5 && units.length > 1) {
    value /= 1000;
    units.shift();
  }
  return `${value.toFixed(value < 10 ? 1 : 0)} ${units[0]}`;
}

export function duration(seconds) {
  if (seconds === null || seconds === undefined) return "";
  if (seconds < 0.0095) return `${(seconds * 1000).toFixed(1)} ms`;
  if (seconds < 0.995) return `${Math.round(seconds * 1000)} ms`;
  if (seconds < 9.95) return `${seconds.toFixed(1)} s`;
  if (seconds < 59.5) return `${Math.round(seconds)} s`;
  const whole = Math.round(seconds);
  const [hours, minutes] = [Math.floor(whole / 3600), Math.floor((whole % 3600) / 60)];
  if (hours >= 48) return `${Math.floor(hours / 24)} d ${hours % 24} h`;
  return hours ? `${hours} h ${minutes} min` : `${minutes} min ${whole % 60} s`;
}

export function count(number) {
  const units = [[1e9, " G"], [1e6, " M"], [1e3, " k"]];
  const [size, unit] = units.find(([least]) => number >= least) ?? [1, ""];
  return `${(number / size).toFixed(size === 1 ? 0 : 1)}${unit}`;
}

export function ago(time) {
  const seconds = Math.max(0, (Date.now() - new Date(time)) / 1000);
  if (seconds < 45) return "just now";
  if (seconds < 3600) return `${Math.max(1, Math.round(seconds / 60))} min ago`;
  if (seconds < 86400) return `${Math.round(seconds / 3600)} h ago`;
  return new Date(time).toLocaleDateString();
}

export function moment(time) {
  return new Date(time).toLocaleString();
}

export function percent(fraction) {
  return `${Math.floor(fraction * 100)} %`;
}

/** A value of the scene as read from the film: enough digits to tell neighbours apart. */
export function radiance(value) {
  if (!Number.isFinite(value)) return String(value);
  const size = Math.abs(value);
  if (size !== 0 && (size < 1e-3 || size >= 1e5)) return value.toExponential(3);
  return value.toFixed(size < 10 ? 4 : 2);
}

export function sceneName(job) {
  return job.scene.name ?? job.scene.entry ?? "Inline scene";
}

/** "512 × 512 · 64 spp": what is known of a job's image. */
export function summary(job) {
  const frames = job.frames ? `${job.frames.count} frames` : null;
  const { width, height, spp, integrator } = job.settings;
  const size = width || height ? `${width ?? "…"} × ${height ?? "…"}` : null;
  const samples = job.stats?.spp ?? spp;
  return [frames, size, samples && `${samples} spp`, integrator].filter(Boolean).join(" · ");
}

/** One line on how the job is. */
export function note(job) {
  if (job.error && job.state === "failed") return job.error.detail;
  if (job.state === "queued") return queuedNote(job);
  if (job.state === "running") return runningNote(job);
  const parts = [job.timings.run_s !== null && duration(job.timings.run_s)];
  if (job.cached) parts.unshift("from the cache");
  if (job.complete === false) parts.push("partial image");
  return parts.filter(Boolean).join(" · ");
}

const PHASES = { waiting: "starting", load: "loading the scene", encode: "writing the images", gather: "putting the frames together" };

function queuedNote(job) {
  const before = job.queue_position;
  if (job.attempts > 0) return "will be tried again";
  if (before === null || before === undefined) return "waiting";
  const place = before === 0 ? "next" : `${before} before it`;
  const eta = job.eta?.start_s;
  return eta >= 1 ? `${place} · starts in about ${duration(eta)}` : place;
}

function runningNote(job) {
  const { phase, spp_done: done, spp, frame, frames, eta_s: own } = job.progress;
  const eta = frames ? job.eta?.end_s : own;
  if (job.cancel_requested) return "stopping";
  if (phase !== "render") return PHASES[phase] ?? phase;
  const inFrame = spp ? `${done ?? 0} of ${spp} spp` : "rendering";
  const samples = frames ? `frame ${frame ?? 1} of ${frames}` : inFrame;
  return eta === null || eta === undefined ? samples : `${samples} · ${duration(Math.ceil(eta))} left`;
}
