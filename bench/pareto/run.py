#!/usr/bin/env python3
"""Run time against error: renders scenes whose pictures are known, with every knob turned, by both hiders.

    bench/pareto/run.py --bin build/release/bin --out pareto [--repeats 3] [scene ...]

Writes pareto.json, pareto.csv, a table of slopes (slopes.md) and an SVG per knob to the folder of --out. Of each picture: seconds of the whole program,
root mean square error, mean squared error relative to the squared value, worst pixel, and peak memory in MiB (of the
program, or of its ray tracer, whichever is larger). Slopes of the error over the number of samples or rays are fitted;
one that is flatter than random sampling (-1/2) is a defect, unless what is left is not the samples' error."""

import argparse
import csv
import json
import math
import os
import pathlib
import subprocess
import sys
import tempfile
import time

import exr
import plot
import scenes

# Where errors end that more samples cannot help: facets and half a raster step.
FLOOR = 1e-3


def render(arguments, hider, scene, knobs, folder):
    """Seconds, MiB and the red channel."""
    name = scenes.SCENES[scene]
    (folder / 'scene.rib').write_text(name.rib(knobs))
    if hider == 'reyes':
        command = [arguments.bin / 'frankenrender', '--quiet', '--no-progress', '--threads', str(arguments.threads)]
        if 'error' in knobs:
            command += ['--error', str(knobs['error'])]
    else:
        command = [arguments.bin / 'rendrib', '-silent']
        if 'error' in knobs:
            command += ['-error', str(knobs['error'])]
    if 'patch_multiplier' in knobs:
        text = (folder / 'scene.rib').read_text()
        (folder / 'scene.rib').write_text(text.replace(
            'WorldBegin\n', f'WorldBegin\nAttribute "render" "float patch_multiplier" [{knobs["patch_multiplier"]}]\n', 1))
    best, memory = math.inf, 0
    for _ in range(arguments.repeats):
        started = time.monotonic()
        child = subprocess.Popen(command + ['scene.rib'], cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.STDOUT)
        said = child.stdout.read().decode()
        _, status, usage = os.wait4(child.pid, 0)
        best = min(best, time.monotonic() - started)
        memory = max(memory, usage.ru_maxrss / 1024)
        if status != 0:
            sys.exit(f'{scene} {knobs}: exit status {os.waitstatus_to_exitcode(status)}\n{said}')
    return best, memory, exr.read(folder / 'out.exr')[2]['R']


def closed_form(scene):
    """Means over the pixels, from points in the middle of small squares."""
    n, size, value = scene.fine, scenes.SIZE, scene.value
    steps = [(i + 0.5) / n for i in range(n)]
    return [sum(value(x + sx, y + sy) for sx in steps for sy in steps) / (n * n)
            for y in range(size) for x in range(size)]


def errors(picture, truth):
    off = [a - b for a, b in zip(picture, truth)]
    mean = sum(d * d for d in off) / len(off)
    relative = sum(d * d / (t * t + 1e-4) for d, t in zip(off, truth)) / len(off)
    return math.sqrt(mean), relative, max(abs(d) for d in off)


def slope(points):
    """Least squares over logarithms."""
    xs, ys = [math.log(x) for x, _ in points], [math.log(y) for _, y in points]
    mx, my = sum(xs) / len(xs), sum(ys) / len(ys)
    return sum((x - mx) * (y - my) for x, y in zip(xs, ys)) / sum((x - mx) ** 2 for x in xs)


def amount(sweep, knobs):
    if sweep == 'levels':
        return f'{"by footprint" if knobs["levels"] else "off"}, {knobs["patch_multiplier"]}'
    return knobs['samples'] ** 2 if sweep == 'samples' else knobs[sweep]


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('--bin', type=pathlib.Path, default=pathlib.Path('build/release/bin'))
    parser.add_argument('--out', type=pathlib.Path, default=pathlib.Path('pareto'))
    parser.add_argument('--threads', type=int, default=os.cpu_count())
    parser.add_argument('--repeats', type=int, default=1)
    parser.add_argument('scenes', nargs='*', help='names: ' + ', '.join(scenes.SCENES))
    arguments = parser.parse_args()
    arguments.bin = arguments.bin.resolve()
    unknown = [s for s in arguments.scenes if s not in scenes.SCENES]
    if unknown:
        parser.error(f'no such scene: {", ".join(unknown)}')
    arguments.out.mkdir(parents=True, exist_ok=True)
    rows, slopes, missed = [], [], 0
    with tempfile.TemporaryDirectory() as temporary:
        folder = pathlib.Path(temporary)
        for name, text in scenes.SHADERS.items():
            (folder / f'{name}.sl').write_text(text)
        for name in arguments.scenes or scenes.SCENES:
            scene = scenes.SCENES[name]
            truth = closed_form(scene) if scene.value else None
            for hider, other in (('reyes', 'rays'), ('rays', 'reyes')):
                if not scene.value:
                    # The other hider, 64 samples for each of 4 x 4, and micropolygons a sixteenth as large.
                    truth = render(arguments, other, name, {'samples': 32, 'rate': 0.0625, 'patch_multiplier': 1}, folder)[2]
                for sweep, points in scene.sweeps.items():
                    if hider == 'rays' and sweep == 'rate':
                        continue  # rays are shaded where they hit
                    if hider == 'reyes' and sweep == 'samples' and 'rays' in scene.sweeps:
                        continue  # samples of one micropolygon all see what its rays have found
                    line = []
                    for knobs in points:
                        if sweep != 'rate':
                            knobs = {'rate': scene.rate, **knobs}
                        seconds, memory, picture = render(arguments, hider, name, knobs, folder)
                        rmse, relative, worst = errors(picture, truth)
                        rows.append({'scene': name, 'hider': hider, 'sweep': sweep, 'amount': amount(sweep, knobs),
                                     'seconds': round(seconds, 4), 'rmse': rmse, 'relative_mse': relative, 'worst': worst,
                                     'MiB': round(memory, 1)})
                        line.append((amount(sweep, knobs), rmse))
                    if sweep in ('samples', 'rays'):
                        # What is down at the floor says nothing of samples.
                        used = [p for i, p in enumerate(line) if p[1] > FLOOR or i < 2]
                        fitted = slope(used)
                        bad = fitted > -0.5 and used[-1][1] > 2 * FLOOR
                        missed += bad
                        slopes.append({'scene': name, 'hider': hider, 'knob': sweep, 'slope': round(fitted, 3),
                                       'from': line[0][1], 'to': line[-1][1]})
                        print(f'{name:15} {hider:6} {sweep:8} RMSE {line[0][1]:.2e} ... {line[-1][1]:.2e}, slope {fitted:6.2f}'
                              f'{"  flatter than random sampling" if bad else ""}', flush=True)
                    else:
                        print(f'{name:15} {hider:6} {sweep:8} RMSE ' + ' '.join(f'{p[1]:.2e}' for p in line), flush=True)
    (arguments.out / 'pareto.json').write_text(json.dumps({'points': rows, 'slopes': slopes}, indent=1) + '\n')
    with open(arguments.out / 'slopes.md', 'w') as file:
        file.write('| scene | hider | knob | RMSE at the least | at the most | slope |\n|---|---|---|---:|---:|---:|\n')
        for s in slopes:
            file.write(f'| {s["scene"]} | {s["hider"]} | {s["knob"]} | {s["from"]:.1e} | {s["to"]:.1e} | {s["slope"]:.2f} |\n')
    with open(arguments.out / 'pareto.csv', 'w', newline='') as file:
        writer = csv.DictWriter(file, rows[0].keys())
        writer.writeheader()
        writer.writerows(rows)
    for sweep in sorted({r['sweep'] for r in rows}):
        lines = {}
        for r in rows:
            if r['sweep'] == sweep:
                lines.setdefault(f'{r["scene"]}, {r["hider"]}', []).append((r['seconds'], max(r['rmse'], 1e-6)))
        (arguments.out / f'{sweep}.svg').write_text(
            plot.curves(f'Error against time, {sweep}', 'seconds, whole program', 'root mean square error', lines))
    return 1 if missed else 0


if __name__ == '__main__':
    sys.exit(main())
