"""Images that several threads read before they are asked for."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from functools import cache
from typing import Any, TypeVar

import numpy.typing as npt

from raykiln.image.codec import Source, read_image

Key = TypeVar("Key")
Pixels = npt.NDArray[Any]

# Each holds an image that is being decoded, beside those that are.
MAX_THREADS = 8


@contextmanager
def reading_ahead(sources: Mapping[Key, Source]) -> Iterator[Callable[[Key], Pixels]]:
    """Have several threads read images.

    Parameters
    ----------
    sources
        Paths, or the bytes of files, by any key; begun in this order.

    Yields
    ------
    A function from a key to the pixels, as `read_image` returns or raises them.  Each source is
    read once, and none after leaving.
    """
    threads = min(len(sources), len(os.sched_getaffinity(0)), MAX_THREADS)
    if threads < 2:
        yield cache(lambda key: read_image(sources[key]))
        return
    from concurrent.futures import ThreadPoolExecutor  # a hundredth of a second to import

    with ThreadPoolExecutor(threads, "raykiln-images") as pool:
        reading = {key: pool.submit(read_image, source) for key, source in sources.items()}
        try:
            yield lambda key: reading[key].result()
        finally:
            pool.shutdown(wait=False, cancel_futures=True)
