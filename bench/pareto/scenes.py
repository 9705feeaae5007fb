"""Scenes whose pictures are known in closed form, and some that are not.

A scene has RIB for given knobs, and the radiance at a point of the raster. Pictures are square, of SIZE pixels."""

import math
import pathlib

SIZE = 64
FOCAL = SIZE / 2 / math.tan(math.radians(20))  # of PERSPECTIVE, in pixels
PERSPECTIVE = 'Projection "perspective" "fov" [40]\n'
ORTHOGRAPHIC = 'Projection "orthographic"\nScreenWindow -1.25 1.25 -1.25 1.25\nTranslate 0 0 5\n'


def orthographic(x, y):
    """Of a raster point, on the plane z = 0 of ORTHOGRAPHIC."""
    return x / SIZE * 2.5 - 1.25, 1.25 - y / SIZE * 2.5


def perspective(x, y):
    """On the plane z = 1 of PERSPECTIVE."""
    return (x - SIZE / 2) / FOCAL, (SIZE / 2 - y) / FOCAL


def frame(knobs, camera, world, options=''):
    samples, rate = knobs.get('samples', 4), knobs.get('rate', 1)
    if 'var' in knobs:
        options += f'PixelVariance {knobs["var"]}\nOption "render" "integer minsamples" [16] "integer maxsamples" [256]\n'
    if 'levels' in knobs:
        options += f'Option "trace" "string levels" ["{"on" if knobs["levels"] else "off"}"]\n'
    return (f'Display "out.exr" "openexr" "rgba" "string exrpixeltype" ["float"] "string compression" ["none"]\n'
            f'Format {SIZE} {SIZE} 1\nPixelSamples {samples} {samples}\nPixelFilter "box" 1 1\nShadingRate {rate}\n'
            f'{options}{camera}WorldBegin\nSides 2\n{world}WorldEnd\n')


class Scene:
    def __init__(self, rib, value=None, sweeps=(), fine=16, rate=1):
        # `rate`: ShadingRate at which micropolygons show neither in shading nor in outlines.
        self.rib, self.value, self.sweeps, self.fine, self.rate = rib, value, sweeps, fine, rate


# --- a Lambert sphere under a distant light ---

def lambert_rib(k):
    return frame(k, ORTHOGRAPHIC, 'LightSource "distantlight" 1 "from" [1 1 -2] "to" [0 0 0]\n'
                                  'Surface "matte" "Ka" [0] "Kd" [1]\nSphere 1 -1 1 360\n')


def lambert(x, y):
    px, py = orthographic(x, y)
    zz = 1 - px * px - py * py
    return max(0.0, (px + py + 2 * math.sqrt(zz)) / math.sqrt(6)) if zz > 0 else 0.0


# --- a mirror ball in a large world whose light depends on the direction ---

SKY = 'surface sky() { vector d = normalize(vector transform("world", P)); Oi = 1;\n  Ci = 0.5 + 0.5 * sin(4 * xcomp(d)) * cos(3 * ycomp(d)); }\n'
BALL = 'surface ball() { Oi = 1; Ci = trace(P, reflect(normalize(I), normalize(N))); }\n'


def mirror_rib(k):
    return frame(k, ORTHOGRAPHIC,
                 'AttributeBegin Attribute "visibility" "integer camera" [0] '
                 'Attribute "render" "integer visibility" [6] Surface "sky" Sphere 1e4 -1e4 1e4 360 AttributeEnd\n'
                 'Surface "ball" Sphere 1 -1 1 360\n')


def mirror(x, y):
    px, py = orthographic(x, y)
    zz = 1 - px * px - py * py
    if zz <= 0:
        return 0.0
    nz = -math.sqrt(zz)  # I = (0, 0, 1)
    d = (-2 * nz * px, -2 * nz * py, 1 - 2 * nz * nz)
    return 0.5 + 0.5 * math.sin(4 * d[0]) * math.cos(3 * d[1])


# --- a square light over a plane ---

def area_light_rib(k):
    return frame(k, ORTHOGRAPHIC,
                 'AttributeBegin Attribute "render" "integer visibility" [6] '
                 f'Attribute "light" "int nsamples" [{k.get("rays", 16)}] AreaLightSource "arealight" 7 "intensity" [1]\n'
                 'Surface "constant" Polygon "P" [-.5 -.5 -1 .5 -.5 -1 .5 .5 -1 -.5 .5 -1] AttributeEnd\n'
                 'Illuminate 7 1 Surface "matte" "Ka" [0] "Kd" [1] Polygon "P" [-9 -9 0 -9 9 0 9 9 0 9 -9 0]\n')


def area_light(x, y):
    px, py = orthographic(x, y)

    def corner(a, b):
        r, s = math.sqrt(1 + a * a), math.sqrt(1 + b * b)
        return (a / r * math.atan(b / r) + b / s * math.atan(a / s)) / 2

    # Form factor times pi, of the four rectangles between the light's corners and the foot of the point.
    total = sum(sa * sb * corner(sa * 0.5 - px, sb * 0.5 - py) for sa in (-1, 1) for sb in (-1, 1))
    return total


# --- what is seen through a slab of glass ---

GLASS = ('surface glass1() { normal Nf = faceforward(normalize(N), I); vector R = refract(normalize(I), Nf, 1 / 1.5);\n'
         '  Oi = 1; Ci = trace(P, R); }\n')
GLASS2 = ('surface glass2() { normal Nf = faceforward(normalize(N), I); vector R = refract(normalize(I), Nf, 1.5);\n'
          '  Oi = 1; Ci = trace(P, R); }\n')
WAVES = 'surface waves() { point p = transform("world", P); Oi = 1; Ci = 0.5 + 0.5 * sin(6 * xcomp(p)) * cos(4 * ycomp(p)); }\n'


def slab_rib(k):
    def square(z, name, half=9):
        return f'Surface "{name}" Polygon "P" [-{half} -{half} {z} -{half} {half} {z} {half} {half} {z} {half} -{half} {z}]\n'
    return frame(k, PERSPECTIVE, square(1, 'glass1') + square(2, 'glass2') + square(4, 'waves'))


def slab(x, y):
    px, py = perspective(x, y)
    tangent = math.hypot(px, py)
    if tangent < 1e-9:
        return 0.5
    sine = tangent / math.sqrt(1 + tangent * tangent) / 1.5
    r = 3 * tangent + sine / math.sqrt(1 - sine * sine)
    return 0.5 + 0.5 * math.sin(6 * r * px / tangent) * math.cos(4 * r * py / tangent)


# --- the sky that a floor sees beside a wall ---

CORNER = 'surface corner(float rays = 16) { Oi = 1; Ci = 1 - occlusion(P, faceforward(normalize(N), I), rays); }\n'


def corner_rib(k):
    return frame(k, ORTHOGRAPHIC,
                 f'Surface "corner" "float rays" [{k.get("rays", 16)}] Polygon "P" [-9 -90 0 -9 90 0 9 90 0 9 -90 0]\n'
                 'Attribute "render" "integer visibility" [6] Polygon "P" [-1.3 -900 0 -1.3 900 0 -1.3 900 -1 -1.3 -900 -1]\n')


def corner(x, y):
    distance = orthographic(x, y)[0] + 1.3
    return 1 - (1 - distance / math.hypot(distance, 1)) / 2


# --- a zone plate ---

PLATE = 'surface plate() { point p = transform("world", P); Oi = 1; Ci = 0.5 + 0.5 * cos(20 * (xcomp(p) * xcomp(p) + ycomp(p) * ycomp(p))); }\n'


def plate_rib(k):
    return frame(k, ORTHOGRAPHIC, 'Surface "plate" Polygon "P" [-9 -9 0 -9 9 0 9 9 0 9 -9 0]\n')


def plate(x, y):
    px, py = orthographic(x, y)
    return 0.5 + 0.5 * math.cos(20 * (px * px + py * py))


# --- blur ---

def moving_rib(k):
    return frame(k, ORTHOGRAPHIC, 'Surface "constant" MotionBegin [0 1] Translate -.6 0 0 Translate .6 0 0 MotionEnd\n'
                                  'Rotate 20 0 0 1 Polygon "P" [-9 -9 0 -9 9 0 0 9 0 0 -9 0]\n', 'Shutter 0 1\n')


def moving(x, y):
    # Covered from the time on when the edge, which leans by 20 degrees, has passed.
    px, py = orthographic(x, y)
    edge = px + py * math.tan(math.radians(20))
    return min(1.0, max(0.0, (0.6 - edge) / 1.2))


def defocused_rib(k):
    # A lens of diameter 1, in focus at 4; the edge at 8.
    return frame(k, 'DepthOfField 2 2 4\n' + PERSPECTIVE,
                 'Surface "constant" Translate 0 0 8 Rotate 20 0 0 1 Polygon "P" [-90 -90 0 -90 90 0 0 90 0 0 -90 0]\n')


def defocused(x, y):
    px, py = perspective(x, y)
    radius = 0.5 / 4 * abs(1 - 4 / 8)  # of the circle of confusion, on the plane z = 1
    t = (px + py * math.tan(math.radians(20))) * math.cos(math.radians(20)) / radius
    if abs(t) >= 1:
        return 1.0 if t < 0 else 0.0
    return 0.5 - (t * math.sqrt(1 - t * t) + math.asin(t)) / math.pi


# --- no closed form: the other hider, at many more samples, is the yardstick ---

def teapot_rib(k):
    return frame(k, PERSPECTIVE + 'Translate 0 -1 9\nRotate -25 1 0 0\n',
                 'Attribute "light" "string shadows" ["on"]\nLightSource "distantlight" 1 "from" [2 3 -4] "to" [0 0 0]\n'
                 'LightSource "ambientlight" 2 "intensity" [0.2]\n'
                 'Surface "matte" Polygon "P" [-9 0 -9 -9 0 9 9 0 9 9 0 -9]\n'
                 'Surface "plastic" Color [.9 .5 .3] Rotate -90 1 0 0 Geometry "teapot"\n')


# Rays of all directions from everywhere, and a large light: they may see coarse levels.
HAZE = 'surface haze() { Oi = 1; Ci = 0.3 + 0.7 * diffuse(faceforward(normalize(N), I)) - 0.3 * occlusion(P, faceforward(normalize(N), I), 16); }\n'


def soft_rib(k):
    return frame(k, PERSPECTIVE + 'Translate 0 -1 9\nRotate -25 1 0 0\n',
                 'AttributeBegin Attribute "visibility" "integer camera" [0] "integer diffuse" [0] "integer specular" [0] '
                 'Attribute "light" "int nsamples" [16] AreaLightSource "arealight" 7 "intensity" [3]\n'
                 'Surface "constant" Polygon "P" [-2 6 -2 2 6 -2 2 6 2 -2 6 2] AttributeEnd\n'
                 'Illuminate 7 1 Surface "haze"\nPolygon "P" [-9 0 -9 -9 0 9 9 0 9 9 0 -9]\n'
                 'Rotate -90 1 0 0 Geometry "teapot"\n')


DRAGON = pathlib.Path(__file__).resolve().parents[2] / 'examples' / 'models' / 'dragon.rib.gz'


def dragon_rib(k):
    return frame(k, 'Projection "perspective" "fov" [34]\nTranslate 0 0 215\nRotate -16 1 0 0\nRotate -25 0 1 0\nTranslate 2 -58 0\n',
                 'LightSource "ambientlight" 1 "intensity" [0.3]\nAttribute "light" "string shadows" ["on"]\n'
                 'LightSource "distantlight" 2 "intensity" [0.9] "from" [60 160 -120] "to" [0 60 0]\nSurface "matte"\n'
                 'Polygon "P" [-600 26.3 -300 -600 26.3 900 600 26.3 900 600 26.3 -300]\n'
                 f'Color [.25 .55 .3] Surface "plastic" "roughness" [.08] ReadArchive "{DRAGON}"\n')


SAMPLES = [{'samples': n} for n in (1, 2, 4, 8, 16)]
RATES = [{'rate': r, 'samples': 8} for r in (16, 4, 1, 0.25)]
RAYS = [{'rays': n, 'samples': 2} for n in (1, 4, 16, 64, 256)]
ERRORS = [{'error': e} for e in (0.05, 0.02, 0.01, 0.005)]
VARIANCES = [{'var': v} for v in (1e-2, 1e-3, 1e-4, 1e-5)]
FOOTPRINTS = [{'levels': on, 'patch_multiplier': m, 'samples': 8} for m in (0.25, 1) for on in (0, 1)]
LEVELS = [{'patch_multiplier': m, 'samples': 4} for m in (0.125, 0.25, 0.5, 1)]

SHADERS = {'sky': SKY, 'ball': BALL, 'glass1': GLASS, 'glass2': GLASS2, 'waves': WAVES, 'corner': CORNER, 'plate': PLATE, 'haze': HAZE}
SCENES = {
    'lambert': Scene(lambert_rib, lambert, {'samples': SAMPLES, 'rate': RATES, 'error': ERRORS, 'var': VARIANCES}, 32, rate=0.0625),
    'mirror': Scene(mirror_rib, mirror, {'samples': SAMPLES, 'rate': RATES, 'error': ERRORS, 'var': VARIANCES}, 32, rate=0.0625),
    'area-light': Scene(area_light_rib, area_light, {'rays': RAYS, 'samples': SAMPLES}, 4, rate=0.25),
    'glass-slab': Scene(slab_rib, slab, {'samples': SAMPLES, 'rate': RATES}, 16, rate=0.0625),
    'corner': Scene(corner_rib, corner, {'rays': RAYS}, 4),
    'zone-plate': Scene(plate_rib, plate, {'samples': SAMPLES, 'rate': RATES, 'error': ERRORS, 'var': VARIANCES}, 32, rate=0.0625),
    'moving-edge': Scene(moving_rib, moving, {'samples': SAMPLES, 'error': ERRORS, 'var': VARIANCES}, 16),
    'defocused-edge': Scene(defocused_rib, defocused, {'samples': SAMPLES, 'error': ERRORS, 'var': VARIANCES}, 16),
    'teapot': Scene(teapot_rib, None, {'samples': SAMPLES, 'rate': RATES, 'error': ERRORS, 'var': VARIANCES, 'patch_multiplier': LEVELS}, rate=0.0625),
    'soft-teapot': Scene(soft_rib, None, {'patch_multiplier': LEVELS, 'levels': FOOTPRINTS}, rate=0.0625),
    'dragon': Scene(dragon_rib, None, {'samples': SAMPLES, 'rate': RATES, 'error': ERRORS, 'var': VARIANCES, 'patch_multiplier': LEVELS},
                    rate=0.25),
}
