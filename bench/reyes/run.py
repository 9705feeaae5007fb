#!/usr/bin/env python3
"""Renders the benchmark's scenes with frankenrender, and prints seconds, peak memory, and what each stage did: its share of
the threads' time, and millions of micropolygons (diced, tested against samples) or points (shaded) a second of it.

    bench/reyes/run.py --program build/release/bin/frankenrender [--threads 1,2] [--repeats 3] [scene ...]

A run with n threads has n processors to itself: the ray tracer is another process, with n threads of its own, which would otherwise
make use of what the renderer leaves idle, so that one thread would not be compared with two but with one and a half. --anywhere leaves
processors to the system.

Peak memory is of frankenrender and its ray tracer together, resident pages counted once a process (an upper bound)."""

import argparse
import json
import os
import pathlib
import re
import subprocess
import sys
import tempfile
import time

import scenes


def processors(count):
    """As many of those that this process may use."""
    return sorted(os.sched_getaffinity(0))[:count]


def run(program, rib, folder, threads, pinned):
    pin = (lambda: os.sched_setaffinity(0, processors(threads))) if pinned else None
    started = time.monotonic()
    done = subprocess.run([program, '--stats', '--no-progress', '--threads', str(threads), rib], cwd=folder,
                          capture_output=True, text=True, preexec_fn=pin)
    seconds = time.monotonic() - started
    if done.returncode != 0:
        sys.exit(f'{rib}: exit status {done.returncode}\n{done.stderr}')
    return seconds, done.stdout + done.stderr


def number(pattern, text):
    found = re.search(pattern, text, re.MULTILINE)
    return float(found.group(1)) if found else 0.0


STAGES = {'dice': 'dice', 'hide': 'hide', 'shade': 'shade', 'wait': 'wait for ray tracer', 'composite': 'composite',
          'filter': 'filter and write'}


def stages(report, threads):
    """Of each stage: its share of the time of all threads; and what went through it, in millions a second."""
    wall = number(r'render, wall clock\s+([\d.]+)', report)
    seconds = {name: number(rf'^ *{text}\s+([\d.]+)', report) for name, text in STAGES.items()}
    through = {'dice': number(r'\((\d+) micropolygons', report), 'hide': number(r'\((\d+) micropolygons tested', report),
               'shade': number(r'grids shaded\s+\d+\s+\((\d+) points', report)}
    shares = {name: round(s / max(wall * threads, 1e-9), 3) for name, s in seconds.items()}
    rates = {name: round(n / 1e6 / seconds[name], 2) if seconds[name] > 0 else None for name, n in through.items()}
    return {'shares': shares, 'rates': rates}


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('--program', default='build/release/bin/frankenrender')
    parser.add_argument('--threads', type=lambda s: [int(n) for n in s.split(',')], default=[os.cpu_count()],
                        help='numbers of threads, with commas between them')
    parser.add_argument('--anywhere', action='store_true', help='do not keep a run to as many processors as it has threads')
    parser.add_argument('--repeats', type=int, default=1)
    parser.add_argument('--json', help='write all figures to this file')
    parser.add_argument('--keep', help='write the scenes to this folder, and leave them there')
    parser.add_argument('scenes', nargs='*', help='names: ' + ', '.join(scenes.SCENES))
    arguments = parser.parse_args()
    program = str(pathlib.Path(arguments.program).resolve())
    unknown = [s for s in arguments.scenes if s not in scenes.SCENES]
    if unknown:
        parser.error(f'no such scene: {", ".join(unknown)}')
    rows = []
    with tempfile.TemporaryDirectory() as temporary:
        folder = pathlib.Path(arguments.keep or temporary)
        folder.mkdir(parents=True, exist_ok=True)
        for name, text in scenes.SHADERS.items():
            (folder / f'{name}.sl').write_text(text)
        print(f'{"scene":24} {"threads":>7} {"seconds":>8} {"MiB":>6} {"M points shaded":>15} {"M rays":>7}'
              '  share of threads: ' + ' '.join(f'{n:>9}' for n in STAGES) + '  M/s: dice  hide shade')
        for name in arguments.scenes or scenes.SCENES:
            (folder / f'{name}.rib').write_text(scenes.SCENES[name]())
            for threads in arguments.threads:
                best, report = min((run(program, f'{name}.rib', folder, threads, not arguments.anywhere) for _ in range(arguments.repeats)),
                                   key=lambda r: r[0])
                row = {'scene': name, 'threads': threads, 'seconds': round(best, 3),
                       'MiB': number(r'both \(PSS\)\s+([\d.]+)', report) or number(r'REYES process\s+PSS ([\d.]+)', report),
                       'shaded': number(r'grids shaded\s+\d+\s+\((\d+) points', report) / 1e6,
                       **stages(report, threads), 'rays': sum(float(n) for n in re.findall(r'(\d+) from (?:REYES|shaders)', report)) / 1e6}
                rows.append(row)
                print(f'{name:24} {threads:7} {best:8.2f} {row["MiB"]:6.0f} {row["shaded"]:15.2f} {row["rays"]:7.2f}' + ' ' * 20 +
                      ' '.join(f'{100 * row["shares"][n]:8.0f}%' for n in STAGES) + '  ' + ' ' * 4 +
                      ' '.join(f'{row["rates"][n] or 0:5.1f}' for n in ('dice', 'hide', 'shade')), flush=True)
    if arguments.json:
        pathlib.Path(arguments.json).write_text(json.dumps(rows, indent=1) + '\n')


if __name__ == '__main__':
    main()
