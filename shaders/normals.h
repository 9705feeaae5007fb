/* Normals for shading.

   Shaders written for other renderers include this file for shadingnormal(N): N with unit length, turned to the viewer
   on two-sided surfaces. It is built in, so there is nothing left to define. */
#ifndef NORMALS_H
#define NORMALS_H 1
#endif
