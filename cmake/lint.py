#!/usr/bin/env python3
"""Checks the sources with clang-format and clang-tidy; exits 1 if either has something to say.

cmake --build build/dev --target lint         everything
cmake/lint.py --build build/dev base/ ri/     only what lies in these folders
"""
import argparse
import json
import os
import pathlib
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor

ROOT = pathlib.Path(__file__).resolve().parent.parent


def tracked(patterns):
    """Files that git knows or would take: a new file is checked before it is committed."""
    out = subprocess.run(["git", "-C", ROOT, "ls-files", "-z", "--cached", "--others", "--exclude-standard",
                          "--", *patterns], check=True, capture_output=True, text=True).stdout
    return [f for f in sorted(set(out.split("\0"))) if f and (ROOT / f).exists()]


def check_format(files):
    bad = []
    for i in range(0, len(files), 50):
        run = subprocess.run(["clang-format", "--dry-run", "-Werror", *files[i:i + 50]], cwd=ROOT,
                             capture_output=True, text=True)
        if run.returncode:
            bad.append(run.stderr)
    print("".join(bad), end="", file=sys.stderr)
    return not bad


def write_database(build, files):
    """One command a file: kernels are compiled once per instruction set, their text is the same."""
    wanted = {str(ROOT / f): f for f in files}
    kept = {}
    with open(build / "compile_commands.json", encoding="utf-8") as f:
        for entry in json.load(f):
            name = wanted.get(entry["file"])
            if name is not None and (name not in kept or "FR_ISA=avx2" in entry["command"]):
                kept[name] = entry
    folder = build / "lint"
    folder.mkdir(exist_ok=True)
    (folder / "compile_commands.json").write_text(json.dumps(list(kept.values())), encoding="utf-8")
    return folder, sorted(kept)


def check_tidy(build, files, jobs):
    folder, names = write_database(build, files)
    clean = True

    def one(name):
        # The database is GCC's: clang does not know all of its warnings.
        return name, subprocess.run(["clang-tidy", "--quiet", "-p", folder,
                                     "--extra-arg=-Wno-unknown-warning-option", name],
                                    cwd=ROOT, capture_output=True, text=True)

    with ThreadPoolExecutor(jobs) as pool:
        for done, (name, run) in enumerate(pool.map(one, names), 1):
            if sys.stderr.isatty():
                print(f"\r\x1b[K[{done}/{len(names)}] {name}", end="", file=sys.stderr, flush=True)
            if run.returncode or run.stdout.strip():
                clean = False
                print(f"\n{run.stdout or run.stderr}", end="", flush=True)
    if sys.stderr.isatty():
        print("\r\x1b[K", end="", file=sys.stderr)
    return clean


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--build", type=pathlib.Path, default=ROOT / "build/dev",
                        help="folder with compile_commands.json (default: %(default)s)")
    parser.add_argument("--only", choices=["format", "tidy"], help="run one of the two")
    parser.add_argument("-j", "--jobs", type=int, default=os.cpu_count())
    parser.add_argument("paths", nargs="*", default=["."], help="files and folders below the root")
    a = parser.parse_args()
    # Headers of shaders/ are RSL.
    files = [f for f in tracked(a.paths) if f.endswith((".h", ".cpp")) and not f.startswith("shaders/")]
    clean = a.only == "tidy" or check_format(files)
    if a.only != "format":
        clean = check_tidy(a.build.resolve(), [f for f in files if f.endswith(".cpp")], a.jobs) and clean
    print("lint: clean" if clean else "lint: not clean", file=sys.stderr)
    return 0 if clean else 1


if __name__ == "__main__":
    sys.exit(main())
