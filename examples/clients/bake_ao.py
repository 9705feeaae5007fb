#!/usr/bin/env python3
"""Bakes ambient occlusion into the vertices of a mesh, through libfrankenray and the standard library alone.

    bake_ao.py bunny.rib baked.rib [--samples 256] [--picture bunny.png]

Reads the first PointsPolygons of a RIB file, asks the ray server for visibility over the hemisphere of every vertex, and
writes a RIB with one color per vertex ("vertex color Cs") that any renderer can show: frankenrender baked.rib. The mesh
stands on a ground plane. --picture also draws the vertices, near ones over far ones, without any renderer.
"""
import argparse
import array
import ctypes
import math
import os
import random
import re
import struct
import sys
import tempfile
import zlib

# ---- libfrankenray (frankenray.h) -----------------------------------------------------------------------------------

OK = 0
VISIBILITY = 1


class Points(ctypes.Structure):
    """frankenray_points, _vectors and their _out forms: three columns and a stride."""
    _fields_ = [("x", ctypes.c_void_p), ("y", ctypes.c_void_p), ("z", ctypes.c_void_p), ("stride", ctypes.c_ssize_t)]

    @classmethod
    def interleaved(cls, values):
        address, _ = values.buffer_info()
        return cls(address, address + values.itemsize, address + 2 * values.itemsize, 3)


class Rays(ctypes.Structure):
    _fields_ = [("size", ctypes.c_size_t), ("kind", ctypes.c_int), ("level", ctypes.c_int), ("count", ctypes.c_size_t),
                ("label", ctypes.c_char_p), ("origin", Points), ("direction", Points), ("target", Points),
                ("time", ctypes.c_void_p), ("radius", ctypes.c_void_p), ("spread", ctypes.c_void_p),
                ("seed", ctypes.c_void_p)]


class Answers(ctypes.Structure):
    _fields_ = [("size", ctypes.c_size_t), ("color", Points), ("distance", ctypes.c_void_p), ("position", Points),
                ("normal", Points), ("miss_depth", ctypes.c_void_p), ("miss_position", Points),
                ("miss_direction", Points)]


class RayServer:
    """A ray server of our own for one scene."""

    def __init__(self, scene, library):
        self._lib = lib = ctypes.CDLL(library)
        for name in ("frankenray_create", "frankenray_line_open"):
            getattr(lib, name).restype = ctypes.c_void_p
        for name in ("frankenray_error_text", "frankenray_line_error_text"):
            getattr(lib, name).restype = ctypes.c_char_p
            getattr(lib, name).argtypes = [ctypes.c_void_p]
        lib.frankenray_start.argtypes = [ctypes.c_void_p, ctypes.c_void_p, ctypes.c_char_p]
        lib.frankenray_line_open.argtypes = lib.frankenray_close.argtypes = [ctypes.c_void_p]
        lib.frankenray_line_close.argtypes = [ctypes.c_void_p]
        lib.frankenray_answer.argtypes = [ctypes.c_void_p, ctypes.POINTER(Rays), ctypes.POINTER(Answers)]
        self._session = lib.frankenray_create()
        if lib.frankenray_start(self._session, None, os.fsencode(scene)) != OK:
            raise RuntimeError(lib.frankenray_error_text(self._session).decode())
        self._line = lib.frankenray_line_open(self._session)

    def visibility(self, origins, targets):
        """array('d') of xyz each; array('f') of rgb: 1 clear ... 0 opaque."""
        count = len(origins) // 3
        colors = array.array("f", bytes(12 * count))
        rays = Rays(size=ctypes.sizeof(Rays), kind=VISIBILITY, level=1, count=count,
                    origin=Points.interleaved(origins), target=Points.interleaved(targets))
        answers = Answers(size=ctypes.sizeof(Answers), color=Points.interleaved(colors))
        if self._lib.frankenray_answer(self._line, rays, answers) != OK:
            raise RuntimeError(self._lib.frankenray_line_error_text(self._line).decode())
        return colors

    def close(self):
        self._lib.frankenray_line_close(self._line)
        self._lib.frankenray_close(self._session)


def find_library():
    """Beside an installed or built example, else by the linker's rules."""
    here = os.path.dirname(os.path.abspath(__file__))
    for folder in (os.environ.get("FRANKENRAY_LIBRARY_DIR", ""), os.path.join(here, "../../build/release/lib")):
        path = os.path.join(folder, "libfrankenray.so.1")
        if folder and os.path.exists(path):
            return path
    return "libfrankenray.so.1"


# ---- The mesh -------------------------------------------------------------------------------------------------------

def read_mesh(path):
    """The numbers of the first PointsPolygons: vertices per face, indices, P, N."""
    text = re.sub(r"^\s*#.*$", "", open(path, encoding="utf-8").read(), flags=re.M)
    body = text[text.index("PointsPolygons"):]
    lists = re.match(r"PointsPolygons\s*\[([^\]]*)\]\s*\[([^\]]*)\]", body)
    faces, indices = ([int(x) for x in part.split()] for part in lists.groups())
    found = {name: array.array("d", map(float, values.split()))
             for name, values in re.findall(r'"(?:\w+ )*(P|N)"\s*\[([^\]]*)\]', body)}
    return faces, indices, found["P"], found["N"]


def write_list(out, values, form):
    for i in range(0, len(values), 12):
        out.write(" ".join(form % v for v in values[i:i + 12]) + "\n")


def write_mesh(out, faces, indices, P, N, colors=None):
    out.write("PointsPolygons [\n")
    write_list(out, faces, "%d")
    out.write("] [\n")
    write_list(out, indices, "%d")
    out.write('] "vertex point P" [\n')
    write_list(out, P, "%.9g")
    out.write('] "vertex normal N" [\n')
    write_list(out, N, "%.6g")
    if colors:
        out.write('] "vertex color Cs" [\n')
        write_list(out, colors, "%.4g")
    out.write("]\n")


def write_ground(out, low, size):
    y, s = low, 4 * size
    out.write('Surface "constant"\nColor [0.8 0.8 0.8]\n'
              'Polygon "P" [%g %g %g  %g %g %g  %g %g %g  %g %g %g]\n'
              % (-s, y, -s, -s, y, s, s, y, s, s, y, -s))


def bounds(P):
    low = [min(P[c::3]) for c in range(3)]
    high = [max(P[c::3]) for c in range(3)]
    return low, high, math.dist(low, high)


# ---- The bake -------------------------------------------------------------------------------------------------------

def hemisphere(samples, rotation):
    """Stratified directions around +z, density proportional to the cosine."""
    side = max(1, round(math.sqrt(samples)))
    for i in range(side * side):
        u = (i % side + 0.5) / side
        v = ((i // side + 0.5) / side + rotation) % 1.0
        r, phi = math.sqrt(u), 2 * math.pi * v
        yield r * math.cos(phi), r * math.sin(phi), math.sqrt(1 - u)


def bake(server, P, N, samples, size, vertices_per_batch=256):
    """Fraction of the cosine-weighted hemisphere that is open, for every vertex."""
    far, lift = 2 * size, 1e-4 * size
    random.seed(1)
    result = []
    count = len(P) // 3
    for first in range(0, count, vertices_per_batch):
        origins, targets = array.array("d"), array.array("d")
        last = min(count, first + vertices_per_batch)
        for i in range(first, last):
            n = N[3 * i:3 * i + 3]
            length = math.hypot(*n) or 1.0
            n = [x / length for x in n]
            helper = (0, 1, 0) if abs(n[0]) > 0.7 else (1, 0, 0)
            a = (n[1] * helper[2] - n[2] * helper[1], n[2] * helper[0] - n[0] * helper[2],
                 n[0] * helper[1] - n[1] * helper[0])
            length = math.hypot(*a)
            a = [x / length for x in a]
            b = (n[1] * a[2] - n[2] * a[1], n[2] * a[0] - n[0] * a[2], n[0] * a[1] - n[1] * a[0])
            start = [P[3 * i + c] + lift * n[c] for c in range(3)]
            for x, y, z in hemisphere(samples, random.random()):
                origins.extend(start)
                targets.extend(start[c] + far * (x * a[c] + y * b[c] + z * n[c]) for c in range(3))
        colors = server.visibility(origins, targets)
        rays = len(origins) // 3 // (last - first)
        for i in range(last - first):
            result.append(sum(colors[3 * rays * i:3 * rays * (i + 1):3]) / rays)
    return result


# ---- A picture without a renderer -----------------------------------------------------------------------------------

def write_png(path, width, height, rows):
    def chunk(kind, data):
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
    data = zlib.compress(b"".join(b"\0" + bytes(row) for row in rows), 9)
    with open(path, "wb") as out:
        out.write(b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0)) +
                  chunk(b"IDAT", data) + chunk(b"IEND", b""))


def draw(path, faces, indices, P, open_fraction, height=480):
    """Triangles along +z, parallel, shaded by the vertices' values."""
    low, high, _ = bounds(P)
    scale = 0.9 * height / max(high[1] - low[1], 1e-9)
    width = int((high[0] - low[0]) * scale / 0.9)
    rows = [bytearray(b"\x30" * width) for _ in range(height)]
    depth = [[math.inf] * width for _ in range(height)]
    at = 0
    for n in faces:
        corner = indices[at:at + n]
        at += n
        for k in range(1, n - 1):
            t = [(0.5 * width + (P[3 * i] - 0.5 * (low[0] + high[0])) * scale,
                  0.95 * height - (P[3 * i + 1] - low[1]) * scale, -P[3 * i + 2], open_fraction[i])
                 for i in (corner[0], corner[k], corner[k + 1])]
            (x0, y0, z0, a0), (x1, y1, z1, a1), (x2, y2, z2, a2) = t
            area = (x1 - x0) * (y2 - y0) - (x2 - x0) * (y1 - y0)
            if area == 0:
                continue
            for y in range(max(0, int(min(y0, y1, y2))), min(height, int(max(y0, y1, y2)) + 2)):
                for x in range(max(0, int(min(x0, x1, x2))), min(width, int(max(x0, x1, x2)) + 2)):
                    v = ((x - x0) * (y2 - y0) - (x2 - x0) * (y - y0)) / area
                    w = ((x1 - x0) * (y - y0) - (x - x0) * (y1 - y0)) / area
                    if v < 0 or w < 0 or v + w > 1:
                        continue
                    z = z0 + v * (z1 - z0) + w * (z2 - z0)
                    if z < depth[y][x]:
                        depth[y][x] = z
                        value = a0 + v * (a1 - a0) + w * (a2 - a0)
                        rows[y][x] = max(0, min(255, round(255 * max(0.0, value) ** (1 / 2.2))))
    write_png(path, width, height, rows)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("mesh", help="RIB file with a PointsPolygons")
    parser.add_argument("baked", help="RIB file to write")
    parser.add_argument("--samples", type=int, default=256, help="rays per vertex (default %(default)s)")
    parser.add_argument("--picture", help="also draw the vertices into this PNG file")
    parser.add_argument("--library", default=find_library(), help="libfrankenray (default %(default)s)")
    options = parser.parse_args()

    faces, indices, P, N = read_mesh(options.mesh)
    low, high, size = bounds(P)
    with tempfile.TemporaryDirectory() as folder:
        scene = os.path.join(folder, "scene.rib")
        with open(scene, "w", encoding="utf-8") as out:
            # The server divides surfaces as finely as this camera would need them.
            out.write('Format 256 256 1\nProjection "perspective" "fov" [40]\nTranslate 0 0 %g\nWorldBegin\n' % (3 * size))
            write_ground(out, low[1], size)
            write_mesh(out, faces, indices, P, N)
            out.write("WorldEnd\n")
        server = RayServer(scene, options.library)
        open_fraction = bake(server, P, N, options.samples, size)
        server.close()

    center = [(a + b) / 2 for a, b in zip(low, high)]
    with open(options.baked, "w", encoding="utf-8") as out:
        out.write('Display "baked_ao.exr" "file" "rgba"\nFormat 640 480 1\nProjection "perspective" "fov" [40]\n'
                  "PixelSamples 3 3\nTranslate 0 0 %g\nRotate -15 1 0 0\nScale 1 1 -1\nTranslate %g %g %g\nWorldBegin\n"
                  % (1.6 * size, -center[0], -center[1], -center[2]))
        write_ground(out, low[1], size)
        colors = [min(1.0, max(0.0, a)) for a in open_fraction for _ in range(3)]
        write_mesh(out, faces, indices, P, N, colors)
        out.write("WorldEnd\n")
    if options.picture:
        draw(options.picture, faces, indices, P, open_fraction)
    print("%d vertices, %d rays each: open %.3f ... %.3f, mean %.3f" % (
        len(open_fraction), max(1, round(math.sqrt(options.samples))) ** 2, min(open_fraction), max(open_fraction),
        sum(open_fraction) / len(open_fraction)))
    return 0


if __name__ == "__main__":
    sys.exit(main())
