"""Writes the bundled scenes anew: `python scenes/generate [NAME...]`; without names, all of them.

Each module here makes one scene: `build()` returns the bytes of its files by their names within
`scenes/`.  The same code gives the same bytes.
"""

from __future__ import annotations

import argparse
from importlib import import_module
from pathlib import Path

FOLDER = Path(__file__).parent
HELPERS = {"__main__", "glb", "kit", "paint"}
SCENES = sorted({path.stem for path in FOLDER.glob("*.py")} - HELPERS)


def main() -> None:
    """Write the files of the named scenes."""
    parser = argparse.ArgumentParser(prog="scenes/generate", description=__doc__)
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"of: {', '.join(SCENES)}")
    for name in parser.parse_args().names or SCENES:
        if name not in SCENES:
            parser.error(f"no scene is named {name!r}; accepted: {', '.join(SCENES)}")
        for file, content in import_module(name).build().items():
            path = FOLDER.parent / file
            path.parent.mkdir(exist_ok=True)
            path.write_bytes(content)
            print(f"{file}: {len(content):,} bytes")


if __name__ == "__main__":
    main()
