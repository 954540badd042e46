"""raykiln: a path tracer for pipelines.  `import raykiln as rk`, then `rk.render(rk.load_scene(...))`."""
