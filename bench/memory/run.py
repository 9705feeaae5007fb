#!/usr/bin/env python3
"""What scenes cost in memory and time to get at them: everything that docs/performance.md says about it.

    bench/memory/run.py [--programs build/release/bin] [--out docs/memory] [part ...]

Parts: one_or_two, bytes, first_pixel, build_rate, budget (all but the last by default: it takes tens of minutes and
gigabytes of disk). Figures are printed as Markdown and, with --out, written to that folder with charts as SVG."""

import argparse
import hashlib
import json
import os
import pathlib
import pty
import subprocess
import sys
import tempfile
import time

import processes
import scenes
import svg

MIB = 1 << 20


def mib(n):
    return f'{n / MIB:.0f}'


class Bench:
    def __init__(self, arguments, folder):
        self.bin = pathlib.Path(arguments.programs).resolve()
        self.arguments, self.folder = arguments, folder
        self.out = pathlib.Path(arguments.out) if arguments.out else None
        if self.out:
            self.out.mkdir(parents=True, exist_ok=True)
        self.text = []

    def program(self, name):
        return str(self.bin / name)

    def say(self, line=''):
        print(line, flush=True)
        self.text.append(line)

    def table(self, head, rows):
        self.say('| ' + ' | '.join(head) + ' |')
        self.say('| ' + ' | '.join(['---'] * len(head)) + ' |')
        for row in rows:
            self.say('| ' + ' | '.join(str(c) for c in row) + ' |')
        self.say()

    def chart(self, name, text):
        if self.out:
            (self.out / f'{name}.svg').write_text(text)
            self.say(f'![{name}](memory/{name}.svg)\n')

    def watch(self, command, **more):
        run = processes.Watched(command, self.folder, **more)
        if run.status != 0:
            print(run.err[-2000:], file=sys.stderr)
        return run


def one_or_two(b):
    """What a second renderer costs: two scenes as in 1998, one scene, and one renderer."""
    b.say('### One scene or two\n')
    figures = {}
    threads = ['--threads', str(b.arguments.threads)]
    base = [b.program('frankenrender'), '--no-progress'] + threads
    for label, rib in (('stones, most of them behind others or out of view', scenes.one_or_two(b.folder)),
                       ('open ground, all of it in view', scenes.landscape(b.folder)),
                       ('the same, four times as fine', scenes.landscape(b.folder, rate=0.05))):
        runs = {
            'two scenes (--pipe)': b.watch(base + ['--pipe', rib]),
            'one scene (--shm)': b.watch(base + ['--shm', rib]),
            'rendrib alone': b.watch([b.program('rendrib'), '-silent', '-threads', str(b.arguments.threads), '-patch_multiplier', '0.5', rib]),
        }
        rows = []
        for name, run in runs.items():
            parts = []
            for n in sorted({n for _, row in run.samples for n in row}):
                at = max((row[n] for _, row in run.samples if n in row), key=lambda m: m['pss'])
                parts.append(f'{n}: PSS {mib(at["pss"])}, private {mib(at["private"])}, shared {mib(at["shared"])}')
            rows.append([name, f'{run.seconds:.1f}' + ('' if run.status == 0 else f' (status {run.status})'), mib(run.peak()), '; '.join(parts)])
        b.say(f'{label.capitalize()}:\n')
        b.table(['', 'seconds', 'peak PSS of all, MiB', 'each at its own peak, MiB'], rows)
        pipe, shm, alone = (r.peak() for r in runs.values())
        b.say(f'One scene costs {shm / alone:.2f} of rendrib alone (goal 1.15) and {shm / pipe:.2f} of two scenes (goal 0.6).\n')
        series = {name: [(t, v / MIB) for t, v in run.total()] for name, run in runs.items()}
        b.chart('one_or_two' if 'stones' in rib else f'one_or_two_{rib.removesuffix(".rib")}', svg.lines('Memory of all processes', 'seconds', 'PSS, MiB', series))
        figures[rib] = {name: {'seconds': r.seconds, 'peak': r.peak(), 'samples': r.samples} for name, r in runs.items()}
    return figures


def bytes_by_type(b):
    b.say('### Bytes a micropolygon\n')
    rows = json.loads(subprocess.run([b.program('memory_bench'), 'bytes'], check=True, capture_output=True, text=True).stdout)
    parts = ['vertices', 'tree', 'records', 'nodes', 'scene']
    b.table(['type', 'faces', 'a grid'] + parts + ['all', 'goal', 'rays at 0.5', 'Embree triangles', 'compact'],
            [[r['name'], f'{r["faces"] / 1e6:.2f} M {r["face"]}s', f'{r["facesAGrid"]:.0f}'] + [f'{r[p]:.1f}' for p in parts] +
             [f'**{r["all"]:.1f}**', r['goal'] or '', f'{r["allAtHalf"]:.1f}', f'{r["embree"]:.0f}', f'{r["embreeCompact"]:.0f}'] for r in rows])
    b.chart('bytes', svg.bars('Bytes a face, rays at full rate', 'bytes', {r['name']: {p: r[p] for p in parts} for r in rows},
                              ('goal for grids: 40', 40)))
    return rows


def time_to_first_bucket(command, folder):
    """Seconds until the progress bar is drawn first, which is when the first bucket is done; and the exit status."""
    started = time.monotonic()
    pid, terminal = pty.fork()
    if pid == 0:
        os.chdir(folder)
        os.execv(command[0], command)
    first = None
    while True:
        try:
            data = os.read(terminal, 65536)
        except OSError:
            break
        if not data:
            break
        if first is None and b'frame' in data:
            first = time.monotonic() - started
    _, status = os.waitpid(pid, 0)
    os.close(terminal)
    return first, time.monotonic() - started, os.waitstatus_to_exitcode(status)


def first_pixel(b):
    b.say('### First pixel\n')
    rows = []
    figures = {}
    for label, count, visible, rays in (('100 archives, all visible', 100, 100, False),
                                        ('10,000 archives, 100 visible', 10000, 100, False),
                                        ('the same, shaders ask for rays', 10000, 100, True)):
        rib = scenes.archives(b.folder, count, visible, rays)
        command = [b.program('frankenrender'), '--threads', str(b.arguments.threads), '--stats', rib]
        runs = sorted(time_to_first_bucket(command, b.folder) for _ in range(3))
        first, whole, status = runs[len(runs) // 2]
        stats = subprocess.run(command[:-1] + ['--no-progress', rib], cwd=b.folder, capture_output=True, text=True).stdout
        procedurals = next((l.split('procedurals')[1].strip() for l in stats.splitlines() if 'procedurals' in l), '')
        rows.append([label, f'{first:.3f}' if first else 'none', f'{whole:.3f}', procedurals, status])
        figures[label] = {'first': first, 'whole': whole, 'procedurals': procedurals}
    b.table(['scene', 'first bucket, s', 'picture, s', 'archives', 'status'], rows)
    return figures


def build_rate(b):
    b.say('### Build rate\n')
    limits = json.loads(subprocess.run([b.program('memory_bench'), 'limits', str(b.folder)], check=True, capture_output=True, text=True).stdout)
    rows, figures = [], {'limits': limits}
    for label, rib in scenes.build_scenes(b.folder).items():
        for threads in sorted({1, b.arguments.threads}):
            run = b.watch([b.program('scenecache'), 'build', rib, '-o', 'x.fsc', '--json', '-q', '--memory', '512M', '--threads', str(threads)])
            d = json.loads(run.out)
            again = b.watch([b.program('scenecache'), 'build', rib, '-o', 'y.fsc', '--json', '-q', '--reuse', 'x.fsc', '--threads', str(threads)])
            r = json.loads(again.out)
            faces = d['micropolygons'] + d['triangles']
            rows.append([label, threads, f'{faces / 1e6:.1f} M', f'{d["diceSeconds"]:.2f} + {d["seconds"] - d["diceSeconds"]:.2f}',
                         f'{faces / d["processorSeconds"] / 1e6:.2f}', f'{d["bytes"] / d["seconds"] / 1e6:.0f}',
                         mib(run.peak('private')), f'{r["seconds"]:.2f} ({r["gridsReused"] / max(1, r["grids"] + r["meshlets"]):.0%})'])
            figures[f'{label}, {threads}'] = {**d, 'peakPrivate': run.peak('private'), 'reuse': r}
            for file in ('x.fsc', 'y.fsc'):
                (b.folder / file).unlink(missing_ok=True)
    b.table(['scene', 'threads', 'faces', 'dicing + the rest, s', 'M faces / s / core', 'MB/s to disk', 'peak private MiB', 'with --reuse, s (reused)'], rows)
    b.say(f'In the same run: memory copies {limits["copyBytesPerSecond"] / 1e9:.1f} GB/s, the disk takes '
          f'{limits["diskBytesPerSecond"] / 1e6:.0f} MB/s (1 GiB, fsync).\n')
    return figures


def budget(b):
    """One scene in ever smaller budgets: peaks, seconds, and whether the picture is the same."""
    b.say('### Budgets\n')
    figures = {}
    for instances in (False, True):
        rib = scenes.mountain(b.folder, b.arguments.millions, instances, *b.arguments.size)
        picture = b.folder / rib.replace('.rib', '.exr')
        base = [b.program('frankenrender'), '--no-progress', '--stats', '--threads', str(b.arguments.threads)]
        whole, rows, series, reference = None, [], {}, None
        for part in (1, 2, 4, 8, 16):
            limit = None if whole is None else int(whole / part)
            if part > 1 and b.arguments.least and limit < b.arguments.least * MIB:
                break
            memory = [] if limit is None else ['--memory', f'{limit // MIB}M', '--scratch', str(b.folder)]
            picture.unlink(missing_ok=True)
            # A hard limit a little above, so that a leak fails rather than merely shows.
            run = b.watch(base + memory + [rib], limit=limit * 1.25 if limit and b.arguments.cgroup else None)
            digest = hashlib.sha256(picture.read_bytes()).hexdigest() if picture.exists() else None
            whole = whole or run.peak()
            reference = reference or digest
            seconds = figures.get(f'{rib} 1', {}).get('seconds', run.seconds)
            processor = figures.get(f'{rib} 1', {}).get('processor', run.processor)
            name = 'in core' if part == 1 else f'1/{part}'
            rows.append([name, mib(limit) if limit else '', mib(run.peak()), 'yes' if not limit or run.peak() <= limit else 'no',
                         f'{run.seconds:.1f}', f'{run.seconds / seconds:.2f}', f'{run.processor / processor:.2f}', 'yes' if digest and digest == reference else 'no', run.status])
            series[name] = [(t, v / MIB) for t, v in run.total()]
            figures[f'{rib} {part}'] = {'limit': limit, 'peak': run.peak(), 'seconds': run.seconds, 'processor': run.processor, 'same': digest == reference,
                                        'status': run.status, 'stats': run.out}
        b.say(f'{"True instances" if instances else "Distinct displaced copies"}, {b.arguments.millions} million micropolygons:\n')
        b.table(['budget', 'MiB', 'peak PSS, MiB', 'within', 'seconds', 'times in core', 'of processor time', 'same picture', 'status'], rows)
        b.chart('budget_instances' if instances else 'budget', svg.lines('Memory of both processes by budget', 'seconds', 'PSS, MiB', series))
    return figures


PARTS = {'one_or_two': one_or_two, 'bytes': bytes_by_type, 'first_pixel': first_pixel, 'build_rate': build_rate, 'budget': budget}


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('--programs', default='build/release/bin')
    parser.add_argument('--threads', type=int, default=os.cpu_count())
    parser.add_argument('--out', help='folder for figures (memory.json, memory.md) and charts')
    parser.add_argument('--keep', help='write the scenes to this folder, and leave them there')
    parser.add_argument('--millions', type=float, default=200, help='budget: micropolygons when all is diced')
    parser.add_argument('--size', type=int, nargs=2, default=(1920, 1080), help='budget: pixels')
    parser.add_argument('--least', type=int, default=0, help='budget: stop below so many MiB')
    parser.add_argument('--cgroup', action='store_true', help='budget: also a hard limit by a memory control group (version 1, root)')
    parser.add_argument('parts', nargs='*', help='default: all but budget')
    arguments = parser.parse_args()
    unknown = [p for p in arguments.parts if p not in PARTS]
    if unknown:
        parser.error(f'no such part: {", ".join(unknown)}')
    figures = {}
    with tempfile.TemporaryDirectory() as temporary:
        folder = pathlib.Path(arguments.keep or temporary).resolve()
        folder.mkdir(parents=True, exist_ok=True)
        b = Bench(arguments, folder)
        for part in arguments.parts or [p for p in PARTS if p != 'budget']:
            figures[part] = PARTS[part](b)
        if b.out:
            (b.out / 'memory.json').write_text(json.dumps(figures, indent=1) + '\n')
            (b.out / 'memory.md').write_text('\n'.join(b.text) + '\n')


if __name__ == '__main__':
    main()
