/* A shared object for Procedural "DynamicLoad" in many ways at once: its data say what it does. */
#include <ri/ri.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static void balls(int count, float radius) {
  int i;
  for (i = 0; i < count; ++i) {
    RiAttributeBegin();
    RiTranslate((RtFloat)(i - (count - 1) / 2), 0, 0);
    RiSphere(radius, -radius, radius, 360, RI_NULL);
    RiAttributeEnd();
  }
}

/* What needs the state of the procedural's place. */
static void state(void) {
  static RtObjectHandle disk;
  RtInt five[1] = {5};
  RtFloat p[15] = {-1, -1, 0, -.5f, 1, 0, 0, -1, 0, .5f, 1, 0, 1, -1, 0};
  RtFloat width[3] = {.1f, .2f, .3f}, note[3] = {1, 2, 3};
  RtPoint q[1] = {{0, 0, 0}};
  RiCurves("cubic", 1, five, "nonperiodic", "P", p, "width", width, "note", note, RI_NULL);
  disk = RiObjectBegin();
  RiDisk(0, .3f, 360, RI_NULL);
  RiObjectEnd();
  RiTransformBegin();
  RiTranslate(0, -.8f, 0);
  RiObjectInstance(disk);
  RiTransformEnd();
  /* The origin is five in front of the eye: one to the right if that is known. */
  RiTransformPoints("object", "camera", 1, q);
  RiTransformBegin();
  RiTranslate(q[0][2] == 5 ? 1.f : -1.f, 0, 0);
  RiObjectInstance(disk);
  RiTransformEnd();
}

/* A disk and a procedural of one level less, which comes back here. */
static void nested(int level) {
  static char object[4096], data[32];
  static RtString words[2] = {object, data};
  RtBound bound = {-2, 2, -2, 2, -2, 2};
  printf("hello from level %d\n", level);
  fflush(stdout);
  if (level == 0) {
    RiSphere(1, -1, 1, 360, RI_NULL);
    return;
  }
  RiAttributeBegin();
  RiScale(.5f, .5f, .5f);
  RiDisk(0, 1, 360, RI_NULL);
  RiAttributeEnd();
  RiTranslate(.5f, 0, 0);
  RiScale(.5f, .5f, .5f);
  strcpy(object, GENERATOR);
  sprintf(data, "nested %d", level - 1);
  RiProcedural((RtPointer)words, bound, RiProcDynamicLoad, NULL);
}

RtPointer ConvertParameters(char* text) {
  char* copy = malloc(strlen(text) + 1);
  return strcpy(copy, text);
}

void Subdivide(RtPointer data, RtFloat detail) {
  int n = 0;
  float radius = 0;
  (void)detail;
  if (sscanf(data, "balls %d %f", &n, &radius) == 2) balls(n, radius);
  if (strcmp(data, "state") == 0) state();
  if (sscanf(data, "nested %d", &n) == 1) nested(n);
  if (strcmp(data, "crash") == 0) *(volatile int*)8 = 1;
}

void Free(RtPointer data) { free(data); }

void Subdivide2(RtContextHandle context, RtFloat detail, RtInt n, RtToken tokens[], RtPointer values[]) {
  RtInt i, count = 0;
  RtFloat radius = 0;
  RtString kind = "";
  (void)context;
  (void)detail;
  for (i = 0; i < n; ++i) {
    if (strstr(tokens[i], "count")) count = *(RtInt*)values[i];
    if (strstr(tokens[i], "radius")) radius = *(RtFloat*)values[i];
    if (strstr(tokens[i], "kind")) kind = *(RtString*)values[i];
  }
  if (strcmp(kind, "balls") == 0) balls(count, radius);
}
