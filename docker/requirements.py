"""Print what pyproject.toml asks for: `build` for the build, `run` for running."""

import sys
import tomllib
from pathlib import Path

declared = tomllib.loads(Path("pyproject.toml").read_text())
which = {
    "build": declared["build-system"]["requires"],
    "run": declared["project"]["dependencies"],
}
print("\n".join(which[sys.argv[1]]))
