/* Ray questions for shaders of any RenderMan renderer.

   color trace(point from; vector direction)               what comes along the ray
   color visibility(point from, to)                        1 clear ... 0 opaque, by color
   float rayhittest(point from; vector direction;          distance, 1e38 when nothing is hit
                    output point Phit; output vector Nhit)
   float fulltrace(point from; vector direction;           level of the deepest ray that left the scene,
                   output color hitcolor; output float hitdist;      0 when none did
                   output point Phit; output vector Nhit;
                   output point Pmiss; output vector Rmiss)
   color areashadow(point P; float nsamples)               in light shaders: visibility of the light
   color rs_indirect(point P; vector N)                    what comes from all sides of N
   color rs_caustic(point P; vector I; normal N; vector L) black
   float raylevel(), isshadowray()                         0 unless a ray runs the shader

   Under frankenrender (and BMRT) they are part of the language and nothing is defined here. Elsewhere they call the
   plug-in rayserver.so, which asks the ray server that the environment variable RAYSERVER names. All arguments and
   all results are in the shader's "current" space: the server speaks world space, and the macros take care of both
   ways. The outputs of rayhittest and fulltrace are variables, and keep their values when there is nothing to say
   (Phit and Nhit on a miss, Pmiss and Rmiss when the result is 0). Normals and directions may be declared point,
   vector or normal. Trailing options ("label", ...) are for frankenrender alone. */
#ifndef RAYSERVER_H
#define RAYSERVER_H 1

#ifndef FRANKENRENDER
#ifndef BMRT

/* Compilers compare types of arguments exactly, and type many an expression as they like: everything is cast. */
#define rayserver_worldp(p) point transform("world", point (p))
#define rayserver_worldv(v) vector vtransform("world", vector (v))
#define rayserver_worldn(n) normal ntransform("world", normal (n))

/* World space seen from current space: with it the plug-in brings results back. Points and vectors, not a matrix:
   some renderers have no right one for "world". */
#define rayserver_frame \
    point transform("world", "current", point (0, 0, 0)), \
    vector vtransform("world", "current", vector (1, 0, 0)), \
    vector vtransform("world", "current", vector (0, 1, 0)), \
    vector vtransform("world", "current", vector (0, 0, 1))

/* The renderer's own functions of these names, where there are any, trace nothing. */
#define trace(from, direction) \
    (color rayserver_trace(rayserver_worldp(from), rayserver_worldv(direction)))
#define visibility(from, to) \
    (color rayserver_visibility(rayserver_worldp(from), rayserver_worldp(to)))
#define rayhittest(from, direction, Phit, Nhit) \
    (float rayserver_rayhittest(rayserver_worldp(from), rayserver_worldv(direction), Phit, Nhit, rayserver_frame))
#define fulltrace(from, direction, hitcolor, hitdist, Phit, Nhit, Pmiss, Rmiss) \
    (float rayserver_fulltrace(rayserver_worldp(from), rayserver_worldv(direction), \
                               hitcolor, hitdist, Phit, Nhit, Pmiss, Rmiss, rayserver_frame))
#define areashadow(P, nsamples) visibility(P, point "shader" (0, 0, 0))
#define rs_indirect(P, N) \
    (color rayserver_indirect(rayserver_worldp(P), rayserver_worldn(N)))
#define rs_caustic(P, I, N, L) (color (0, 0, 0))
#define raylevel() 0
#define isshadowray() 0

#endif
#endif
#endif
