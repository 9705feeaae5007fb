/* Rings of spheres around a mirror: a picture made by a C program.
 *
 *   cc rings.c $(pkg-config --cflags --libs ri) -lm -o rings
 *   ./rings                 renders rings.exr in this process
 *   ./rings rings.rib       writes RIB instead
 *   ./rings rings.rib binary
 */
#include <math.h>
#include <ri.h>
#include <stdio.h>
#include <string.h>

static const double kPi = 3.14159265358979;

/* What RiProcedural calls: `data` says how many spheres the ring has. */
static RtVoid ring(RtPointer data, RtFloat detail) {
  int i, n = *(int *)data;
  (void)detail;
  for (i = 0; i < n; ++i) {
    double angle = 2 * kPi * i / n;
    RtColor color;
    color[0] = (RtFloat)(0.5 + 0.5 * cos(angle));
    color[1] = (RtFloat)(0.5 + 0.5 * cos(angle - 2 * kPi / 3));
    color[2] = (RtFloat)(0.5 + 0.5 * cos(angle + 2 * kPi / 3));
    RiTransformBegin();
    RiRotate((RtFloat)(360.0 * i / n), 0, 1, 0);
    RiTranslate(2, 0, 0);
    RiColor(color);
    RiSphere(0.3f, -0.3f, 0.3f, 360, RI_NULL);
    RiTransformEnd();
  }
}

int main(int argc, char **argv) {
  RtFloat fov = 35, intensity = 0.9f, Kr = 0.9f, ambient = 0.3f;
  RtPoint from = {-4, 8, -6}, to = {0, 0, 0};
  RtPoint floor_[4] = {{-9, -1, -9}, {-9, -1, 9}, {9, -1, 9}, {9, -1, -9}};
  RtString on = "on";
  RtBound bound = {-3, 3, -1, 1, -3, 3};
  RtColor grey = {0.6f, 0.6f, 0.65f};
  RtPoint corner = {2, 0, 0};
  int spheres = 12, i;

  if (argc > 2) {
    RtString format = argv[2];
    RiOption("rib", "format", &format, RI_NULL);
  }
  RiBegin(argc > 1 ? argv[1] : RI_NULL);
  RiArchiveRecord(RI_STRUCTURE, "Scene rings of %d spheres", spheres);
  RiDisplay("rings.exr", RI_FILE, RI_RGBA, RI_NULL);
  RiFormat(320, 240, 1);
  RiPixelSamples(3, 3);
  RiPixelFilter(RiGaussianFilter, 2, 2);
  RiProjection(RI_PERSPECTIVE, RI_FOV, &fov, RI_NULL);
  RiTranslate(0, 0, 9);
  RiRotate(-25, 1, 0, 0);
  RiWorldBegin();
  RiAttribute("light", "string shadows", &on, RI_NULL);
  RiLightSource(RI_DISTANTLIGHT, RI_INTENSITY, &intensity, RI_FROM, from, RI_TO, to, RI_NULL);
  RiLightSource(RI_AMBIENTLIGHT, RI_INTENSITY, &ambient, RI_NULL);

  RiAttributeBegin();
  RiSurface("shinymetal", RI_KR, &Kr, RI_NULL);
  RiSphere(1, -1, 1, 360, RI_NULL);
  RiAttributeEnd();

  RiSurface(RI_PLASTIC, RI_NULL);
  for (i = -1; i <= 1; ++i) {
    RiAttributeBegin();
    RiRotate(40.0f * (RtFloat)i, 1, 0, 1);
    RiTransformPoints(RI_CURRENT, RI_RASTER, 1, &corner);
    if (argc < 2) printf("ring %d begins at pixel %.0f %.0f\n", i + 2, (double)corner[0], (double)corner[1]);
    corner[0] = 2, corner[1] = corner[2] = 0;
    RiProcedural(&spheres, bound, ring, NULL);
    RiAttributeEnd();
  }

  RiAttributeBegin();
  RiColor(grey);
  RiSurface(RI_MATTE, RI_NULL);
  RiPolygon(4, RI_P, (RtPointer)floor_, RI_NULL);
  RiAttributeEnd();
  RiWorldEnd();
  RiEnd();
  return RiLastError == RIE_NOERROR ? 0 : 1;
}
