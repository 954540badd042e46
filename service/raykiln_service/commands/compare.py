"""`raykiln compare`: how far one image is from another."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from raykiln_service.commands.console import check_writable, print_json, print_note, usage_error

_LABELS = {
    "mean_ratio": "mean ratio",
    "mse": "MSE",
    "rel_mse": "relMSE",
    "psnr": "PSNR (dB)",
    "flip": "FLIP",
    "nonfinite_pixels": "non-finite pixels",
}


def compare(
    a: Annotated[Path, typer.Argument(help="The image.", metavar="A")],
    b: Annotated[Path, typer.Argument(help="The reference.", metavar="B")],
    as_json: Annotated[bool, typer.Option("--json", help="As JSON.")] = False,
    heatmap: Annotated[
        Path | None,
        typer.Option("--heatmap", help="Write a picture of the error here.", metavar="D.png"),
    ] = None,
) -> None:
    """Compare an image with a reference: mean ratio, MSE, relMSE, PSNR, FLIP.

    relMSE = mean((a - b)^2 / (b^2 + 0.01)). A PSNR of "inf" (null in JSON) means no difference.
    """
    from raykiln import image

    if heatmap is not None:
        if heatmap.suffix.lower() != ".png":
            raise usage_error("--heatmap", "cannot write this kind", found=heatmap, accepted=".png")
        check_writable(heatmap, "--heatmap")
    metrics = image.compare_files(a, b).as_dict()
    if as_json:
        print_json(metrics)
    else:
        for name, value in metrics.items():
            shown = "inf" if value is None and name == "psnr" else _number(value)
            print(f"{_LABELS.get(name, name):<18}{shown}")
    if heatmap is not None:
        error = image.error_heatmap(image.read_image(a), image.read_image(b))
        image.write_png(heatmap, error)
        if not as_json:
            print_note(f"{heatmap}")


def _number(value: float | int | None) -> str:
    if value is None:
        return "undefined"
    return str(value) if isinstance(value, int) else f"{value:.6g}"
