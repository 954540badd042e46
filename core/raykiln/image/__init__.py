"""Images: reading and writing files, view transforms, and comparison.

Pixels are NumPy arrays of shape (height, width, channels), rows from the top.
"""

from raykiln.image.atomic import write_atomically
from raykiln.image.codec import (
    encode_exr,
    encode_png,
    read_exr_layers,
    read_exr_metadata,
    read_image,
    write_exr,
    write_png,
)
from raykiln.image.compare import Comparison, compare, compare_files, error_heatmap
from raykiln.image.flip import flip_map
from raykiln.image.view import VIEWS, View, apply_view, srgb_oetf, to_png_pixels

__all__ = [
    "VIEWS",
    "Comparison",
    "View",
    "apply_view",
    "compare",
    "compare_files",
    "encode_exr",
    "encode_png",
    "error_heatmap",
    "flip_map",
    "read_exr_layers",
    "read_exr_metadata",
    "read_image",
    "srgb_oetf",
    "to_png_pixels",
    "write_atomically",
    "write_exr",
    "write_png",
]
