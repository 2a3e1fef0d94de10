"""From two sealed files to two corrected models, with the commands a user types.

    python -m examples.worked FOLDER

The first file hides an effect of the catalogue, which is found and adopted.  The second
hides one that the catalogue lacks: nothing known explains it, until the effect of
`examples/effects/thin_cure.py` is written; then that is found and adopted.  Everything
is written into FOLDER; the commands and what they say are printed.
"""

from __future__ import annotations

import json
import os
import shlex
import subprocess
import sys
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[1]
PBA = (
    sys.executable,
    "-c",
    "import sys; from service.cli import main; sys.exit(main())",
)
EFFECTS = ROOT / "examples" / "effects"

KNOWN = "--seed 32 --devices 4 --size 100"
"""Of the first file: which effect is hidden is drawn from the seed."""

LACKING = "--seed 21 --devices 4 --size 100 --effects cure_gradient"
"""Of the second file: one that is not in the catalogue."""

LEVEL = "--level draft"
"""Mesh of truth and model alike: the example is to take minutes."""


class Shell:
    """Runs ``pba`` in a folder and prints what it says.

    Parameters
    ----------
    folder : Path
        Where files and workspace are; solves are kept there, too.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def run(self, command: str, shown: str = "") -> str:
        """What a command prints."""
        print(f"$ pba {shown or command}", flush=True)
        done = subprocess.run(
            [*PBA, *shlex.split(command)],
            cwd=self.folder,
            env={
                **os.environ,
                "PYTHONPATH": str(ROOT),
                "OMP_NUM_THREADS": "1",
                "PBA_CACHE": str(self.folder / "solves"),
                "PBA_WORKSPACE": str(self.folder / "models"),
                "COLUMNS": "88",
            },
            stdout=subprocess.PIPE,
            text=True,
            check=True,
        )
        return done.stdout

    def json(self, command: str, shown: str = "") -> Any:
        """What a command prints as JSON."""
        return json.loads(self.run(f"{command} --json", shown or command))


def told(ladder: list[dict[str, Any]]) -> str:
    """The ladder in a line: rungs and their errors on devices left out."""
    return ", ".join(f"{one['rung']} {one['heldout_error']:.1f}" for one in ladder)


def investigate(shell: Shell, name: str, folder: str = "") -> str:
    """Rank a set, adopt what is found, and say what came of it; the name found.

    Of names that these readings cannot tell apart the one that stands alone is adopted,
    as the simplest.
    """
    own = f" --effects-dir {folder}" if folder else ""
    said = " --effects-dir examples/effects" if folder else ""
    base = f"{name}/measurements.csv {LEVEL}"
    found = shell.json(f"rank {base}{own}", f"rank {base}{said}")
    print(f"{found['sentence']}\n")
    answer = shell.folder / f"{name}.json"
    answer.write_text(json.dumps(found))
    alone = [one for one in found["effects"] if isinstance(one, str)]
    if found["verdict"] not in ("identified", "tied") or not alone:
        return ""
    best = alone[0]
    model = f"{name}-corrected"
    command = f"adopt {best} {base} --out {model} --report {model}.html"
    made = shell.json(f"{command}{own}", f"{command}{said}")
    print(f"Error on devices left out, in noise: {told(made['ladder'])}.\n")
    return best


def main(folder: Path) -> None:
    """Both files, from sealed to adopted."""
    folder.mkdir(parents=True, exist_ok=True)
    shell = Shell(folder)
    shell.run(f"challenge make first {KNOWN} {LEVEL}")
    print()
    missing = shell.json(f"compare first/measurements.csv {LEVEL}")
    print(f"Something is missing (p-value {missing['p_value']:.2g}).\n")
    investigate(shell, "first")
    print(shell.run("challenge score first first.json"))

    shell.run(f"challenge make second {LACKING} {LEVEL}")
    print()
    investigate(shell, "second")
    investigate(shell, "second", folder=str(EFFECTS))
    print(shell.run("models list"))


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "worked").resolve())
