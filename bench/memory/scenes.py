"""The benchmark's scenes. Every one is written to a folder and returns the name of its RIB file."""

import math
import random

SHADERS = {
    # Distinct copies: what a shader does to a surface depends on where it stands, so no two have the same grids.
    'rock': '''displacement rock(float height = 0.15; float grain = 3;) {
  point p = transform("world", P) * grain;
  float h = 0, a = 1, i;
  for (i = 0; i < 4; i += 1) { h += a * (noise(p) - 0.5); p *= 2.1; a *= 0.5; }
  P += height * h * normalize(N);
  N = calculatenormal(P);
}
''',
    'clay': '''surface clay() {
  normal Nf = faceforward(normalize(N), I);
  Ci = Os * Cs * (ambient() + diffuse(Nf));
  Oi = Os;
}
''',
    'polished': '''surface polished(float kr = 0.4;) {
  normal Nf = faceforward(normalize(N), I);
  Ci = Cs * (ambient() + diffuse(Nf)) + kr * trace(P, reflect(normalize(I), Nf));
  Oi = 1;
}
''',
    'lamp': '''light lamp(float intensity = 1; point from = point "shader" (0, 0, 0);) {
  illuminate(from) Cl = intensity * visibility(Ps, from);
}
''',
}


def write_shaders(folder):
    for name, text in SHADERS.items():
        (folder / f'{name}.sl').write_text(text)


def head(picture, width, height, rate, samples=2):
    return (f'Display "{picture}" "openexr" "rgba" "string compression" "none"\nFormat {width} {height} 1\n'
            f'PixelSamples {samples} {samples}\nShadingRate {rate}\nProjection "perspective" "fov" [50]\n')


LIGHTS = '''LightSource "ambientlight" 1 "float intensity" [0.2]
LightSource "lamp" 2 "point from" [-20 30 -20] "float intensity" [0.9]
'''


def one_or_two(folder, copies=250):
    """Displaced stones over a polished floor: some millions of micropolygons, shadow and mirror rays."""
    write_shaders(folder)
    rng = random.Random(5)
    text = head('stones.exr', 960, 540, 0.25) + 'Translate 0 -2 14\nRotate -18 1 0 0\nWorldBegin\n' + LIGHTS
    text += 'Surface "polished"\nPolygon "P" [-60 -1 -20  60 -1 -20  60 -1 90  -60 -1 90]\nSurface "clay"\n'
    text += ('Displacement "rock" "float height" [0.3]\n'
             'Attribute "displacementbound" "float sphere" [0.3] "string coordinatesystem" ["shader"]\n')
    for _ in range(copies):
        x, z, r = rng.uniform(-12, 12), rng.uniform(-5, 24), rng.uniform(0.3, 1.1)
        text += (f'AttributeBegin\nColor {rng.random():.3f} {rng.random():.3f} {rng.random():.3f}\n'
                 f'Translate {x:.4f} {rng.uniform(-1, 2.5):.4f} {z:.4f}\nRotate {rng.uniform(0, 360):.2f} 1 2 3\n'
                 f'Scale {r:.4f} {r:.4f} {r:.4f}\nSphere 1 -1 1 360\nAttributeEnd\n')
    (folder / 'stones.rib').write_text(text + 'WorldEnd\n')
    return 'stones.rib'


def landscape(folder, side=48, rate=0.2):
    """Open ground under the sun, all of it in view: what the camera sees is what rays meet."""
    write_shaders(folder)
    rng = random.Random(11)
    points = ' '.join(f'{20 * (i / side - 0.5):.4f} {rng.uniform(-0.3, 0.3):.4f} {20 * (j / side - 0.5):.4f}'
                      for j in range(side + 1) for i in range(side + 1))
    name = f'landscape_{rate}'
    text = head(f'{name}.exr', 1280, 720, rate) + 'Translate 0 0 17\nRotate -50 1 0 0\nWorldBegin\n' + LIGHTS + 'Surface "clay"\n'
    text += ('Displacement "rock" "float height" [0.4]\n'
             'Attribute "displacementbound" "float sphere" [0.4] "string coordinatesystem" ["shader"]\n'
             f'Basis "b-spline" 1 "b-spline" 1\nPatchMesh "bicubic" {side + 1} "nonperiodic" {side + 1} "nonperiodic" "P" [{points}]\n')
    (folder / f'{name}.rib').write_text(text + 'WorldEnd\n')
    return f'{name}.rib'


def mountain(folder, millions=200, instances=False, width=1920, height=1080):
    """About so many million micropolygons when all is diced, in displaced stones that are seen: none the same as
    another, or (instances) all the same."""
    write_shaders(folder)
    rng = random.Random(9)
    rate = 0.25
    name = 'instances' if instances else 'mountain'
    text = head(f'{name}.exr', width, height, rate, 1)
    # A stone of a radius of r pixels has 4 pi r^2 pixels of surface; dicing makes 1 / rate of it, and a little more
    # where displacement stretches it.
    radius = 0.05
    distance = 10.0
    pixels = radius / distance / math.tan(math.radians(25)) * height / 2
    copies = max(1, int(millions * 1e6 * rate / (4 * math.pi * pixels * pixels)))
    stone = 'Sphere 1 -1 1 360\n'
    shape = ('Surface "clay"\nDisplacement "rock" "float height" [0.3] "float grain" [2]\n'
             'Attribute "displacementbound" "float sphere" [0.3] "string coordinatesystem" ["shader"]\n')
    if instances:
        # Instances share undisplaced grids.
        shape = 'Surface "clay"\n'
        text += f'ObjectBegin 1\n{stone}ObjectEnd\n'
        stone = 'ObjectInstance 1\n'
    with open(folder / f'{name}.rib', 'w') as f:
        f.write(text + 'Translate 0 0 10\nWorldBegin\n' + LIGHTS + shape)
        half_y = distance * math.tan(math.radians(25))
        half_x = half_y * width / height
        for _ in range(copies):
            # Somewhere in the view, at about the same distance: layers in front of each other.
            z = rng.uniform(-1.5, 1.5)
            s = (distance + z) / distance
            x, y = rng.uniform(-half_x, half_x) * s, rng.uniform(-half_y, half_y) * s
            r = radius * s
            f.write(f'AttributeBegin\nTranslate {x:.5f} {y:.5f} {z:.5f}\nRotate {rng.uniform(0, 360):.2f} {rng.random():.3f} 1 0.3\n'
                    f'Scale {r:.5f} {r:.5f} {r:.5f}\n{stone}AttributeEnd\n')
        f.write('WorldEnd\n')
    return f'{name}.rib'


def archives(folder, count=10000, visible=100, rays=False):
    """`count` archives with bounds; the camera sees `visible` of them."""
    write_shaders(folder)
    (folder / 'parts').mkdir(exist_ok=True)
    name = 'archives_rays' if rays else 'archives'
    text = head(f'{name}.exr', 640, 480, 1) + 'Translate 0 0 12\nWorldBegin\n'
    text += LIGHTS.splitlines()[0] + '\nSurface "polished"\n' if rays else 'Surface "constant"\n'
    side = int(math.ceil(math.sqrt(visible)))
    for i in range(count):
        part = folder / 'parts' / f'{i}.rib'
        part.write_text(f'Color {i % 7 / 7:.3f} {i % 11 / 11:.3f} {i % 13 / 13:.3f}\nSphere 0.3 -0.3 0.3 360\n'
                        'Torus 0.3 0.1 0 360 360\n')
        if i < visible:
            x, y, z = (i % side - side / 2 + 0.5) * 0.8, (i // side - side / 2 + 0.5) * 0.8, 0.0
        else:
            x, y, z = (i % 100 - 50) * 1.0, (i // 100 - 50) * 1.0, -60.0  # behind the camera
        text += (f'AttributeBegin\nTranslate {x:.3f} {y:.3f} {z:.3f}\n'
                 f'Procedural "DelayedReadArchive" ["parts/{i}.rib"] [-0.5 0.5 -0.5 0.5 -0.5 0.5]\nAttributeEnd\n')
    (folder / f'{name}.rib').write_text(text + 'WorldEnd\n')
    return f'{name}.rib'


def build_scenes(folder):
    """What scenecache build is measured with: {label: RIB}."""
    write_shaders(folder)
    made = {}
    rng = random.Random(3)

    def scene(label, file, body, rate):
        (folder / file).write_text(head('x.exr', 1280, 720, rate) + f'Translate 0 0 6\nWorldBegin\n{body}WorldEnd\n')
        made[label] = file

    spheres = ''.join(f'AttributeBegin\nTranslate {rng.uniform(-4, 4):.3f} {rng.uniform(-2, 2):.3f} {rng.uniform(0, 5):.3f}\n'
                      'Sphere 1 -1 1 360\nAttributeEnd\n' for _ in range(60))
    scene('quadrics', 'quadrics.rib', spheres, 0.5)
    scene('displaced quadrics', 'displaced.rib',
          'Displacement "rock"\nAttribute "displacementbound" "float sphere" [0.15] "string coordinatesystem" ["shader"]\n' + spheres, 1)
    patches = ''
    for _ in range(60):
        points = [f'{x + rng.uniform(-0.3, 0.3):.3f} {y + rng.uniform(-0.3, 0.3):.3f} {rng.uniform(-0.5, 0.5):.3f}'
                  for y in range(4) for x in range(4)]
        patches += (f'AttributeBegin\nTranslate {rng.uniform(-4, 2):.3f} {rng.uniform(-2, 0):.3f} {rng.uniform(0, 5):.3f}\n'
                    f'Patch "bicubic" "P" [{" ".join(points)}]\nAttributeEnd\n')
    scene('bicubic patches', 'patches.rib', patches, 0.5)
    cube = ('SubdivisionMesh "catmull-clark" [4 4 4 4 4 4] [0 1 3 2 2 3 5 4 4 5 7 6 6 7 1 0 1 7 5 3 6 0 2 4] ["interpolateboundary"] [0 0] [] [] '
            '"P" [-1 -1 1 1 -1 1 -1 1 1 1 1 1 -1 1 -1 1 1 -1 -1 -1 -1 1 -1 -1]\n')
    scene('subdivision meshes', 'subdivision.rib',
          ''.join(f'AttributeBegin\nTranslate {rng.uniform(-4, 4):.3f} {rng.uniform(-2, 2):.3f} {rng.uniform(0, 5):.3f}\n'
                  f'Rotate {rng.uniform(0, 360):.1f} 1 1 0\n{cube}AttributeEnd\n' for _ in range(60)), 0.5)
    return made
