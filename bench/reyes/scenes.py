"""Scenes of the picture benchmark: each a function that returns RIB text. Random numbers have fixed seeds."""

import math
import random

PERSPECTIVE = 'Projection "perspective" "fov" [40]\n'
LIGHTS = ('LightSource "ambientlight" 1 "intensity" [0.2]\n'
          'LightSource "distantlight" 2 "intensity" [0.8] "from" [2 3 -4] "to" [0 0 0]\n')
SHADOWED = 'Attribute "light" "string shadows" ["on"]\n'


def frame(world, width=640, height=480, samples=4, rate=1.0, options="", camera="Translate 0 0 5\n", lights=LIGHTS):
    return (f'Display "bench.tif" "tiff" "rgba"\nFormat {width} {height} 1\nPixelSamples {samples} {samples}\n'
            f'PixelFilter "gaussian" 2 2\nShadingRate {rate}\n{options}{PERSPECTIVE}{camera}WorldBegin\n'
            f'{lights}{world}WorldEnd\n')


def displaced_sphere():
    return frame('Attribute "displacementbound" "float sphere" [0.2]\nDisplacement "lumps"\nSurface "plastic"\n'
                 'Sphere 1.6 -1.6 1.6 360\n', 1024, 768, rate=0.5)


def subdivision():
    n, m = 24, 12  # a torus of quads with creases along every third ring
    points, faces, creases = [], [], []
    for i in range(n):
        for j in range(m):
            a, b = 2 * math.pi * i / n, 2 * math.pi * j / m
            r = 1.2 + (0.5 if j % 2 else 0.35) * math.cos(b)
            points += [r * math.cos(a), r * math.sin(a), 0.5 * math.sin(b)]
    for i in range(n):
        for j in range(m):
            k, l = (i + 1) % n, (j + 1) % m
            faces += [i * m + j, k * m + j, k * m + l, i * m + l]
    for j in range(0, m, 3):
        creases += [i * m + j for i in range(n)] + [j]
    rings = (m + 2) // 3
    def text(v):
        return ' '.join(f'{x:.5g}' for x in v)
    tags = ' '.join(['"crease"'] * rings)
    return frame(f'Surface "plastic"\nRotate 40 1 0.3 0\nSubdivisionMesh "catmull-clark" [{"4 " * (n * m)}] [{text(faces)}] '
                 f'[{tags}] [{f"{n + 1} 1 " * rings}] [{text(creases)}] [{"3 " * rings}] "P" [{text(points)}]\n', 1024, 768)


def curves(count=50000, width=800, height=600):
    rng = random.Random(1)
    p = []
    for _ in range(count):
        x, z = rng.uniform(-2, 2), rng.uniform(-1, 1)
        for k in range(4):
            p.append(f'{x + 0.15 * k * rng.uniform(-1, 1):.4f} {-1.5 + 0.8 * k + rng.uniform(-0.2, 0.2):.4f} '
                     f'{z + 0.1 * k * rng.uniform(-1, 1):.4f}')
    return frame(f'Surface "plastic"\nBasis "bezier" 3 "bezier" 3\nCurves "cubic" [{"4 " * count}] "nonperiodic" '
                 f'"P" [{" ".join(p)}] "constantwidth" [0.006]\n', width, height)


def hair():
    return curves(100000, 1024, 768)


def marble():
    return frame('Surface "marbled"\nPatch "bilinear" "P" [-2.5 -2 0 2.5 -2 0 -2.5 2 0 2.5 2 0]\n', 1024, 768, 2, 0.25)


def spheres(moving=False):
    rng = random.Random(2)
    out = ['Surface "plastic"\n']
    for _ in range(200):
        x, y, z = rng.uniform(-2, 2), rng.uniform(-1.5, 1.5), rng.uniform(-1.5, 4)
        move = f'Translate {x:.3f} {y:.3f} {z:.3f}\n'
        if moving:
            dx, dy = rng.uniform(-0.4, 0.4), rng.uniform(-0.4, 0.4)
            move = f'MotionBegin [0 1]\n{move}Translate {x + dx:.3f} {y + dy:.3f} {z:.3f}\nMotionEnd\n'
        out.append(f'AttributeBegin\nColor [{rng.random():.2f} {rng.random():.2f} {rng.random():.2f}]\n{move}'
                   f'Sphere 0.2 -0.2 0.2 360\nAttributeEnd\n')
    return ''.join(out)


SHUTTER = 'Shutter 0 1\n'
LENS = 'DepthOfField 2.8 0.28 5\n'


def motion():
    return frame(spheres(True), options=SHUTTER)


def defocus():
    return frame(spheres(), options=LENS)


def motion_and_defocus():
    return frame(spheres(True), options=SHUTTER + LENS)


def motion_and_defocus_8x8():
    return frame(spheres(True), samples=8, options=SHUTTER + LENS)


def transparency():
    rng = random.Random(3)
    out = ['Surface "plastic"\nOpacity [0.4 0.4 0.4]\n']
    for i in range(300):
        out.append(f'AttributeBegin\nColor [{rng.random():.2f} {rng.random():.2f} {rng.random():.2f}]\n'
                   f'Translate {rng.uniform(-1.5, 1.5):.3f} {rng.uniform(-1.2, 1.2):.3f} {0.01 * i:.3f}\n'
                   f'Disk 0 {rng.uniform(0.3, 0.9):.3f} 360\nAttributeEnd\n')
    return frame(''.join(out))


def solids():
    out = ['Surface "plastic"\n']
    rng = random.Random(4)
    for i in range(20):
        x, y = -2 + i % 5, -1.5 + i // 5
        out.append(f'AttributeBegin\nTranslate {x:.2f} {y:.2f} {rng.uniform(0, 1):.2f}\nRotate {rng.uniform(0, 360):.0f} 1 1 0.3\n'
                   'SolidBegin "difference"\nSolidBegin "primitive" Sphere 0.5 -0.5 0.5 360 SolidEnd\n'
                   'SolidBegin "union"\n'
                   'SolidBegin "primitive" Cylinder 0.25 -1 1 360 Disk 1 0.25 360 ReverseOrientation Disk -1 0.25 360 SolidEnd\n'
                   'SolidBegin "primitive" Rotate 90 1 0 0 Cylinder 0.2 -1 1 360 Disk 1 0.2 360 ReverseOrientation Disk -1 0.2 360 SolidEnd\n'
                   'SolidEnd\nSolidEnd\nAttributeEnd\n')
    return frame(''.join(out), 960, 720)


def patches(count=10000):
    rng = random.Random(5)
    out = ['Surface "plastic"\nBasis "bezier" 3 "bezier" 3\n']
    side = int(math.sqrt(count))
    for i in range(count):
        x, y = 4 * (i % side) / side - 2, 3 * (i // side) / side - 1.5
        p = ' '.join(f'{x + 0.012 * (k % 4):.4f} {y + 0.010 * (k // 4):.4f} {rng.uniform(0, 0.02):.4f}' for k in range(16))
        out.append(f'Patch "bicubic" "P" [{p}]\n')
    return ''.join(out)


def patch_field():
    return frame(patches())


def shadowed_patches():
    return frame(patches(), lights=LIGHTS.replace('LightSource "distantlight"', SHADOWED + 'LightSource "distantlight"'))


MIXED = '''Surface "plastic"
AttributeBegin Translate -1.2 0.8 0 Sphere 0.6 -0.6 0.6 360 AttributeEnd
AttributeBegin Translate 0 0.8 0 Rotate 50 1 1 0 Torus 0.45 0.2 0 360 360 AttributeEnd
AttributeBegin Translate 1.2 0.8 0 Rotate -70 1 0.3 0 Cone 1 0.5 360 AttributeEnd
AttributeBegin Translate -1.2 -0.7 0 Rotate 70 1 0.3 0 Cylinder 0.4 -0.5 0.5 360 AttributeEnd
AttributeBegin Translate 0 -0.7 0 Rotate 70 1 0 0 Paraboloid 0.6 0 0.9 360 AttributeEnd
AttributeBegin Translate 1.2 -0.7 0 Rotate 80 1 0 0 Hyperboloid 0.4 0 -0.5 0 0.4 0.5 360 AttributeEnd
AttributeBegin Translate 0 0 1.5 Polygon "P" [-4 -3 0 -4 3 0 4 3 0 4 -3 0] AttributeEnd
AttributeBegin Translate 0 0.1 -0.8 Disk 0 0.3 360 AttributeEnd
AttributeBegin Translate 0.7 0 -0.8 Scale 0.15 0.15 0.15 Rotate -70 1 0 0 Geometry "teapot" AttributeEnd
'''


def mixed():
    return frame(MIXED)


def mixed_shadows():
    lights = ('LightSource "ambientlight" 1 "intensity" [0.2]\n' + SHADOWED +
              'LightSource "distantlight" 2 "intensity" [0.5] "from" [2 3 -4] "to" [0 0 0]\n'
              'LightSource "pointlight" 3 "intensity" [9] "from" [-3 2 -3]\n')
    return frame(MIXED, lights=lights)


def mirrors():
    world = MIXED.replace('Surface "plastic"', 'Surface "shiny"', 1)
    return frame(world, options='Option "render" "integer max_raylevel" [3]\n')


def ambient_occlusion():
    return frame(MIXED.replace('Surface "plastic"', 'Surface "sky" "samples" [64]', 1))


def depth_complexity():
    """Opaque balls of 24 pixels' radius, twenty over each pixel: 0.31 million points would do for what is seen."""
    chance, world = random.Random(20), ['Surface "plastic"\n']
    for _ in range(3394):
        distance = chance.uniform(5, 60)
        half = distance * math.tan(math.radians(20))  # of the view's height
        x, y, r = chance.uniform(-1.33, 1.33) * half, chance.uniform(-1, 1) * half, half / 10
        world.append(f'AttributeBegin Translate {x:.4f} {y:.4f} {distance - 5:.4f} Sphere {r:.4f} {-r:.4f} {r:.4f} 360 AttributeEnd\n')
    world.append('Translate 0 0 62 Polygon "P" [-90 -90 0 -90 90 0 90 90 0 90 -90 0]\n')
    return frame(''.join(world))


SHADERS = {
    'lumps': 'displacement lumps() { point Po = transform("shader", P); float d = 0, a = 1, i;\n'
             '  for (i = 0; i < 5; i += 1) { d += a * (noise(4 * pow(2, i) * Po) - 0.5); a *= 0.5; }\n'
             '  P += 0.15 * d * normalize(N); N = calculatenormal(P); }\n',
    'marbled': 'surface marbled() { point Po = 3 * transform("shader", P); float t = 0, f = 1, i;\n'
               '  for (i = 0; i < 6; i += 1) { t += abs(noise(f * Po) - 0.5) / f; f *= 2; }\n'
               '  color c = spline(clamp(2 * t, 0, 1), color 0.1, color 0.3, color (0.6, 0.6, 0.7), color 0.9, color 1, color 1);\n'
               '  normal Nf = faceforward(normalize(N), I); Oi = Os;\n'
               '  Ci = Os * c * (ambient() + diffuse(Nf)); }\n',
    'shiny': 'surface shiny() { normal Nf = faceforward(normalize(N), I); Oi = Os;\n'
             '  Ci = Os * (0.3 * Cs * (ambient() + diffuse(Nf)) + 0.6 * trace(P, reflect(normalize(I), Nf))); }\n',
    'sky': 'surface sky(float samples = 64) { normal Nf = faceforward(normalize(N), I); Oi = Os;\n'
           '  Ci = Os * Cs * (1 - occlusion(P, Nf, samples)); }\n',
}

SCENES = {f.__name__: f for f in (
    mixed, mixed_shadows, mirrors, ambient_occlusion, displaced_sphere, subdivision, curves, hair, marble, motion, defocus,
    motion_and_defocus, motion_and_defocus_8x8, transparency, solids, patch_field, shadowed_patches, depth_complexity)}
