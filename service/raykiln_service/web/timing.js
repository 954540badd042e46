// Where a job's time went: one bar, and the same in numbers.

import { h, svg } from "./dom.js";
import { count, duration, bytes } from "./format.js";

const PHASES = [
  ["queue_s", "Queue"], ["load_s", "Load"], ["bvh_s", "BVH"], ["render_s", "Render"],
  ["denoise_s", "Denoise"], ["encode_s", "Encode"],
];

/** The phases of a finished job, in seconds; what none of them tells is "Other". */
export function phasesOf(stats) {
  const phases = PHASES.map(([key, name]) => ({ key: key.replace("_s", ""), name, seconds: stats[key] ?? 0 }));
  const rest = (stats.total_s ?? 0) - phases.reduce((sum, { seconds }) => sum + seconds, 0);
  // Loading is told by the scene's clock and the whole by the service's: a little off is no phase.
  if (rest > 0.005) phases.push({ key: "other", name: "Other", seconds: rest });
  return phases;
}

export function timingChart(stats) {
  const phases = phasesOf(stats);
  const total = phases.reduce((sum, { seconds }) => sum + seconds, 0) || 1;
  let at = 0;
  const bars = phases.map(({ key, name, seconds }) => {
    const width = (100 * seconds) / total;
    const bar = svg("rect", { x: at, y: 0, width, height: 10, class: `phase-${key}` }, svg("title", {}, `${name}: ${duration(seconds)}`));
    at += width;
    return bar;
  });
  const rows = phases.map(({ key, name, seconds }) => h("tr", {},
    h("th", { scope: "row" }, h(`i.swatch.phase-${key}`), name),
    h("td", {}, duration(seconds)),
    h("td", {}, `${((100 * seconds) / total).toFixed(seconds / total < 0.0995 ? 1 : 0)} %`)));
  return [
    svg("svg", { class: "bars", viewBox: "0 0 100 10", preserveAspectRatio: "none", "aria-hidden": "true" }, bars),
    h("table.timing", { "aria-label": "Timing" }, h("tbody", {}, rows),
      h("tfoot", {}, h("tr", {}, h("th", { scope: "row" }, "Total"), h("td", {}, duration(stats.total_s ?? total)), h("td")))),
  ];
}

/** The counts of a finished render, as [name, text] pairs. */
export function countsOf(stats) {
  const rays = (stats.camera_rays ?? 0) + (stats.bounce_rays ?? 0) + (stats.shadow_rays ?? 0);
  const pairs = [
    ["Samples per pixel", stats.spp],
    ["Rays", rays && count(rays)],
    ["Rays per second", stats.rays_per_s && count(stats.rays_per_s)],
    ["Triangles", stats.triangles && count(stats.triangles)],
    ["Peak memory", stats.peak_memory_bytes && bytes(stats.peak_memory_bytes)],
    ["Threads", stats.threads],
    ["Dropped samples", stats.nonfinite_samples && count(stats.nonfinite_samples)],
  ];
  return pairs.filter(([, value]) => value);
}
