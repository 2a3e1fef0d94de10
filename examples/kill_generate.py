"""Kill ``pba generate`` at random moments, resume it, and compare the files.

``make kill-test`` runs it.  One run is left alone; another is killed with SIGKILL again
and again, by turns the parent alone or all of its processes, and then finished with
``--resume``.  No finished path may be lost on the way, and the two files must hold the
same values, bit for bit.
"""

from __future__ import annotations

import argparse
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from datagen.dataset import Dataset
from datagen.parts import parts_folder

STARTUP = 1.0
"""s.  Earliest kill; the latest is drawn around the time of a few paths."""


def command(out: Path, given: argparse.Namespace) -> list[str]:
    """The command line of one ``pba generate --resume``."""
    settings = {
        "--designs": given.designs,
        "--seed": given.seed,
        "--level": given.level,
        "--workers": given.workers,
        "--max-pressure": given.max_pressure,
        "--out": out,
    }
    words = [str(word) for pair in settings.items() for word in pair]
    entry = "from service.cli import main; main()"
    return [sys.executable, "-c", entry, "generate", *words, "--resume", "--json"]


def finished(out: Path) -> int:
    """Paths that wait beside the file."""
    return len(list(parts_folder(out).glob("row-*.json")))


def kill_once(out: Path, given: argparse.Namespace, after: float, whole: bool) -> bool:
    """Start a run and kill it after so many seconds; False where it was faster."""
    process = subprocess.Popen(
        command(out, given), start_new_session=True, stdout=subprocess.DEVNULL
    )
    try:
        process.wait(timeout=after)
    except subprocess.TimeoutExpired:
        if whole:
            os.killpg(process.pid, signal.SIGKILL)
        else:
            process.kill()
        process.wait()
        return True
    if process.returncode != 0:
        raise SystemExit(f"the run ended with status {process.returncode}")
    return False


def compare(folder: Path, given: argparse.Namespace) -> int:
    """Kill and resume in a folder, compare, and return how many kills struck.

    Raises
    ------
    SystemExit
        When a finished path was lost, or the two files differ.
    """
    alone, killed = folder / "alone.h5", folder / "killed.h5"
    start = time.perf_counter()
    subprocess.run(command(alone, given), check=True, stdout=subprocess.DEVNULL)
    seconds = time.perf_counter() - start
    print(f"uninterrupted: {given.designs} paths in {seconds:.0f} s", flush=True)

    draw = random.Random(given.seed)
    span = STARTUP + 1.5 * seconds / given.kills
    kills = 0
    while kills < given.kills:
        before, after = finished(killed), draw.uniform(STARTUP, STARTUP + span)
        if not kill_once(killed, given, after, whole=kills % 2 == 0):
            break
        kills += 1
        kept = finished(killed)
        print(f"kill {kills} after {after:.1f} s: {kept} paths kept", flush=True)
        if kept < before and not killed.exists():
            raise SystemExit(f"{before - kept} finished paths were lost")

    subprocess.run(command(killed, given), check=True, stdout=subprocess.DEVNULL)
    one, other = Dataset.read(alone), Dataset.read(killed)
    if one.digest() != other.digest():
        raise SystemExit("the resumed file differs from the uninterrupted one")
    print(f"equal after {kills} kills: {one.digest()}")
    return kills


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--kills", type=int, default=20)
    parser.add_argument("--designs", type=int, default=24)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--level", default="draft")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--max-pressure", type=float, default=150.0, help="kPa")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        kills = compare(Path(folder), given)
    if kills < given.kills:
        raise SystemExit(f"finished after {kills} kills: ask for more --designs")


if __name__ == "__main__":
    main()
