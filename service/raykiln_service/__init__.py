"""The job service around the `raykiln` renderer: a durable queue and its HTTP face."""
