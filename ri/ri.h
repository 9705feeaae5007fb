/* The RenderMan Interface, version 3.2: the C binding of the specification's appendix, and the requests of
 * later renderers that scenes use. For C and C++ programs; link with -lri (pkg-config --cflags --libs ri).
 *
 * RiBegin(RI_NULL) or RiBegin("frankenrender") renders in this process: every RiWorldEnd renders its picture.
 * RiBegin("scene.rib") writes RIB instead ("scene.rib.gz": compressed; "-": to standard output);
 * RiOption("rib", "format", "binary") before RiBegin makes it binary.
 *
 * Functions whose last parameter is "..." take pairs of a token and a pointer to values, closed by RI_NULL.
 * Requests are for one thread at a time. */
#ifndef FRANKENRENDER_RI_H
#define FRANKENRENDER_RI_H

#include <stdarg.h>

#ifdef __cplusplus
extern "C" {
#endif

#define RI_VERSION 320

/* ---- Types ---- */

typedef short RtBoolean;
typedef int RtInt;
typedef float RtFloat;
#ifdef __cplusplus
typedef const char *RtToken; /* C++ has no string literals that are char* */
typedef const char *RtString;
#else
typedef char *RtToken;
typedef char *RtString;
#endif
typedef RtFloat RtColor[3];
typedef RtFloat RtPoint[3];
typedef RtFloat RtVector[3];
typedef RtFloat RtNormal[3];
typedef RtFloat RtHpoint[4];
typedef RtFloat RtMatrix[4][4];
typedef RtFloat RtBasis[4][4];
typedef RtFloat RtBound[6];
typedef void *RtPointer;
#define RtVoid void

typedef RtFloat (*RtFilterFunc)(RtFloat x, RtFloat y, RtFloat xwidth, RtFloat ywidth);
typedef RtVoid (*RtErrorHandler)(RtInt code, RtInt severity, char *message);
typedef RtVoid (*RtProcSubdivFunc)(RtPointer data, RtFloat detail);
typedef RtVoid (*RtProcFreeFunc)(RtPointer data);
typedef RtVoid (*RtArchiveCallback)(RtToken type, char *format, ...);

typedef RtPointer RtObjectHandle;
typedef RtPointer RtLightHandle;
typedef RtPointer RtContextHandle;
typedef RtPointer RtArchiveHandle;

/* ---- Constants ---- */

#define RI_FALSE 0
#define RI_TRUE 1
#define RI_INFINITY ((RtFloat)1.0e38)
#define RI_EPSILON ((RtFloat)1.0e-10)
#define RI_NULL ((RtToken)0)

extern RtToken RI_FRAMEBUFFER, RI_FILE;
extern RtToken RI_RGB, RI_RGBA, RI_RGBZ, RI_RGBAZ, RI_A, RI_Z, RI_AZ;
extern RtToken RI_MERGE, RI_ORIGIN;
extern RtToken RI_PERSPECTIVE, RI_ORTHOGRAPHIC;
extern RtToken RI_HIDDEN, RI_PAINT;
extern RtToken RI_CONSTANT, RI_SMOOTH;
extern RtToken RI_FLATNESS, RI_FOV;
extern RtToken RI_AMBIENTLIGHT, RI_POINTLIGHT, RI_DISTANTLIGHT, RI_SPOTLIGHT;
extern RtToken RI_INTENSITY, RI_LIGHTCOLOR, RI_FROM, RI_TO, RI_CONEANGLE, RI_CONEDELTAANGLE,
    RI_BEAMDISTRIBUTION;
extern RtToken RI_MATTE, RI_METAL, RI_SHINYMETAL, RI_PLASTIC, RI_PAINTEDPLASTIC;
extern RtToken RI_KA, RI_KD, RI_KS, RI_ROUGHNESS, RI_KR, RI_TEXTURENAME, RI_SPECULARCOLOR;
extern RtToken RI_DEPTHCUE, RI_FOG, RI_BUMPY;
extern RtToken RI_MINDISTANCE, RI_MAXDISTANCE, RI_BACKGROUND, RI_DISTANCE, RI_AMPLITUDE;
extern RtToken RI_RASTER, RI_SCREEN, RI_CAMERA, RI_WORLD, RI_OBJECT, RI_NDC, RI_SHADER, RI_CURRENT;
extern RtToken RI_INSIDE, RI_OUTSIDE, RI_LH, RI_RH;
extern RtToken RI_P, RI_PZ, RI_PW, RI_N, RI_NP, RI_NG, RI_CI, RI_OI, RI_CS, RI_OS, RI_S, RI_T, RI_ST;
extern RtToken RI_WIDTH, RI_CONSTANTWIDTH;
extern RtToken RI_BILINEAR, RI_BICUBIC;
extern RtToken RI_LINEAR, RI_CUBIC;
extern RtToken RI_PRIMITIVE, RI_INTERSECTION, RI_UNION, RI_DIFFERENCE;
extern RtToken RI_PERIODIC, RI_NONPERIODIC, RI_CLAMP, RI_BLACK;
extern RtToken RI_IGNORE, RI_PRINT, RI_ABORT, RI_HANDLER;
extern RtToken RI_COMMENT, RI_STRUCTURE, RI_VERBATIM;
extern RtToken RI_IDENTIFIER, RI_NAME, RI_SHADINGGROUP;
extern RtToken RI_CATMULLCLARK, RI_HOLE, RI_CREASE, RI_CORNER, RI_INTERPOLATEBOUNDARY;

extern RtBasis RiBezierBasis, RiBSplineBasis, RiCatmullRomBasis, RiHermiteBasis, RiPowerBasis;

#define RI_BEZIERSTEP ((RtInt)3)
#define RI_BSPLINESTEP ((RtInt)1)
#define RI_CATMULLROMSTEP ((RtInt)1)
#define RI_HERMITESTEP ((RtInt)2)
#define RI_POWERSTEP ((RtInt)4)

/* Code of the last error; RIE_NOERROR if there was none. */
extern RtInt RiLastError;

#define RIE_NOERROR ((RtInt)0)
#define RIE_NOMEM ((RtInt)1)
#define RIE_SYSTEM ((RtInt)2)
#define RIE_NOFILE ((RtInt)3)
#define RIE_BADFILE ((RtInt)4)
#define RIE_VERSION ((RtInt)5)
#define RIE_DISKFULL ((RtInt)6)
#define RIE_INCAPABLE ((RtInt)11)
#define RIE_UNIMPLEMENT ((RtInt)12)
#define RIE_LIMIT ((RtInt)13)
#define RIE_BUG ((RtInt)14)
#define RIE_NOTSTARTED ((RtInt)23)
#define RIE_NESTING ((RtInt)24)
#define RIE_NOTOPTIONS ((RtInt)25)
#define RIE_NOTATTRIBS ((RtInt)26)
#define RIE_NOTPRIMS ((RtInt)27)
#define RIE_ILLSTATE ((RtInt)28)
#define RIE_BADMOTION ((RtInt)29)
#define RIE_BADSOLID ((RtInt)30)
#define RIE_BADTOKEN ((RtInt)41)
#define RIE_RANGE ((RtInt)42)
#define RIE_CONSISTENCY ((RtInt)43)
#define RIE_BADHANDLE ((RtInt)44)
#define RIE_NOSHADER ((RtInt)45)
#define RIE_MISSINGDATA ((RtInt)46)
#define RIE_SYNTAX ((RtInt)47)
#define RIE_MATH ((RtInt)61)

#define RIE_INFO ((RtInt)0)
#define RIE_WARNING ((RtInt)1)
#define RIE_ERROR ((RtInt)2)
#define RIE_SEVERE ((RtInt)3)


/* ---- Contexts, blocks ---- */

RtVoid RiBegin(RtToken name);
RtVoid RiEnd(void);
RtContextHandle RiGetContext(void);
RtVoid RiContext(RtContextHandle handle);
RtVoid RiFrameBegin(RtInt number);
RtVoid RiFrameEnd(void);
RtVoid RiWorldBegin(void);
RtVoid RiWorldEnd(void);
RtVoid RiAttributeBegin(void);
RtVoid RiAttributeEnd(void);
RtVoid RiTransformBegin(void);
RtVoid RiTransformEnd(void);
RtVoid RiSolidBegin(RtToken operation);
RtVoid RiSolidEnd(void);
RtObjectHandle RiObjectBegin(void);
RtVoid RiObjectEnd(void);
RtVoid RiObjectInstance(RtObjectHandle handle);
RtVoid RiMotionBegin(RtInt n, ...);
RtVoid RiMotionBeginV(RtInt n, RtFloat times[]);
RtVoid RiMotionEnd(void);
RtVoid RiResourceBegin(void);
RtVoid RiResourceEnd(void);
/* Conditions as in RIB: "$user:quality > 1". */
RtVoid RiIfBegin(RtToken condition, ...);
RtVoid RiIfBeginV(RtToken condition, RtInt n, RtToken tokens[], RtPointer parms[]);
RtVoid RiElseIf(RtToken condition, ...);
RtVoid RiElseIfV(RtToken condition, RtInt n, RtToken tokens[], RtPointer parms[]);
RtVoid RiElse(void);
RtVoid RiIfEnd(void);
RtToken RiDeclare(RtToken name, RtToken declaration);

/* ---- Options ---- */

RtVoid RiFormat(RtInt xresolution, RtInt yresolution, RtFloat pixelaspect);
RtVoid RiFrameAspectRatio(RtFloat aspect);
RtVoid RiScreenWindow(RtFloat left, RtFloat right, RtFloat bottom, RtFloat top);
RtVoid RiCropWindow(RtFloat xmin, RtFloat xmax, RtFloat ymin, RtFloat ymax);
RtVoid RiProjection(RtToken name, ...);
RtVoid RiProjectionV(RtToken name, RtInt n, RtToken tokens[], RtPointer parms[]);
RtVoid RiClipping(RtFloat hither, RtFloat yon);
RtVoid RiClippingPlane(RtFloat x, RtFloat y, RtFloat z, RtFloat nx, RtFloat ny, RtFloat nz);
RtVoid RiDepthOfField(RtFloat fstop, RtFloat focallength, RtFloat focaldistance);
RtVoid RiShutter(RtFloat opentime, RtFloat closetime);
RtVoid RiCamera(RtToken name, ...);
RtVoid RiCameraV(RtToken name, RtInt n, RtToken tokens[], RtPointer parms[]);
RtVoid RiPixelVariance(RtFloat variation);
RtVoid RiPixelSamples(RtFloat xsamples, RtFloat ysamples);
RtVoid RiPixelFilter(RtFilterFunc filterfunc, RtFloat xwidth, RtFloat ywidth);
RtVoid RiExposure(RtFloat gain, RtFloat gamma);
RtVoid RiImager(RtToken name, ...);
RtVoid RiImagerV(RtToken name, RtInt n, RtToken tokens[], RtPointer parms[]);
RtVoid RiQuantize(RtToken type, RtInt one, RtInt min, RtInt max, RtFloat amplitude);
RtVoid RiDisplay(RtToken name, RtToken type, RtToken mode, ...);
RtVoid RiDisplayV(RtToken name, RtToken type, RtToken mode, RtInt n, RtToken tokens[], RtPointer parms[]);
RtVoid RiDisplayChannel(RtToken channel, ...);
RtVoid RiDisplayChannelV(RtToken channel, RtInt n, RtToken tokens[], RtPointer parms[]);
RtVoid RiHider(RtToken type, ...);
RtVoid RiHiderV(RtToken type, RtInt n, RtToken tokens[], RtPointer parms[]);
RtVoid RiColorSamples(RtInt n, RtFloat nRGB[], RtFloat RGBn[]);
RtVoid RiRelativeDetail(RtFloat relativedetail);
RtVoid RiOption(RtToken name, ...);
RtVoid RiOptionV(RtToken name, RtInt n, RtToken tokens[], RtPointer parms[]);

/* ---- Attributes ---- */

RtVoid RiColor(RtColor color);
RtVoid RiOpacity(RtColor color);
RtVoid RiTextureCoordinates(RtFloat s1, RtFloat t1, RtFloat s2, RtFloat t2, RtFloat s3, RtFloat t3,
    RtFloat s4, RtFloat t4);
RtLightHandle RiLightSource(RtToken name, ...);
RtLightHandle RiLightSourceV(RtToken name, RtInt n, RtToken tokens[], RtPointer parms[]);
RtLightHandle RiAreaLightSource(RtToken name, ...);
RtLightHandle RiAreaLightSourceV(RtToken name, RtInt n, RtToken tokens[], RtPointer parms[]);
RtVoid RiIlluminate(RtLightHandle light, RtBoolean onoff);
RtVoid RiSurface(RtToken name, ...);
RtVoid RiSurfaceV(RtToken name, RtInt n, RtToken tokens[], RtPointer parms[]);
RtVoid RiDisplacement(RtToken name, ...);
RtVoid RiDisplacementV(RtToken name, RtInt n, RtToken tokens[], RtPointer parms[]);
RtVoid RiAtmosphere(RtToken name, ...);
RtVoid RiAtmosphereV(RtToken name, RtInt n, RtToken tokens[], RtPointer parms[]);
RtVoid RiInterior(RtToken name, ...);
RtVoid RiInteriorV(RtToken name, RtInt n, RtToken tokens[], RtPointer parms[]);
RtVoid RiExterior(RtToken name, ...);
RtVoid RiExteriorV(RtToken name, RtInt n, RtToken tokens[], RtPointer parms[]);
RtVoid RiDeformation(RtToken name, ...);
RtVoid RiDeformationV(RtToken name, RtInt n, RtToken tokens[], RtPointer parms[]);
RtVoid RiShaderLayer(RtToken type, RtToken name, RtToken layername, ...);
RtVoid RiShaderLayerV(RtToken type, RtToken name, RtToken layername, RtInt n, RtToken tokens[],
    RtPointer parms[]);
RtVoid RiConnectShaderLayers(RtToken type, RtToken layer1, RtToken variable1, RtToken layer2,
    RtToken variable2);
RtVoid RiShadingRate(RtFloat size);
RtVoid RiShadingInterpolation(RtToken type);
RtVoid RiMatte(RtBoolean onoff);
RtVoid RiBound(RtBound bound);
RtVoid RiDetail(RtBound bound);
RtVoid RiDetailRange(RtFloat minvisible, RtFloat lowertransition, RtFloat uppertransition,
    RtFloat maxvisible);
RtVoid RiGeometricApproximation(RtToken type, RtFloat value);
RtVoid RiGeometricRepresentation(RtToken type);
RtVoid RiOrientation(RtToken orientation);
RtVoid RiReverseOrientation(void);
RtVoid RiSides(RtInt sides);
RtVoid RiAttribute(RtToken name, ...);
RtVoid RiAttributeV(RtToken name, RtInt n, RtToken tokens[], RtPointer parms[]);
RtVoid RiResource(RtToken handle, RtToken type, ...);
RtVoid RiResourceV(RtToken handle, RtToken type, RtInt n, RtToken tokens[], RtPointer parms[]);

/* ---- Transformations ---- */

RtVoid RiIdentity(void);
RtVoid RiTransform(RtMatrix transform);
RtVoid RiConcatTransform(RtMatrix transform);
RtVoid RiPerspective(RtFloat fov);
RtVoid RiTranslate(RtFloat dx, RtFloat dy, RtFloat dz);
RtVoid RiRotate(RtFloat angle, RtFloat dx, RtFloat dy, RtFloat dz);
RtVoid RiScale(RtFloat sx, RtFloat sy, RtFloat sz);
RtVoid RiSkew(RtFloat angle, RtFloat dx1, RtFloat dy1, RtFloat dz1, RtFloat dx2, RtFloat dy2, RtFloat dz2);
RtVoid RiCoordinateSystem(RtToken space);
RtVoid RiScopedCoordinateSystem(RtToken space);
RtVoid RiCoordSysTransform(RtToken space);
/* In place; NULL and RIE_BADTOKEN for a space that nobody named. */
RtPoint *RiTransformPoints(RtToken fromspace, RtToken tospace, RtInt n, RtPoint points[]);

/* ---- Geometry ---- */

RtVoid RiPolygon(RtInt nverts, ...);
RtVoid RiPolygonV(RtInt nverts, RtInt n, RtToken tokens[], RtPointer parms[]);
RtVoid RiGeneralPolygon(RtInt nloops, RtInt nverts[], ...);
RtVoid RiGeneralPolygonV(RtInt nloops, RtInt nverts[], RtInt n, RtToken tokens[], RtPointer parms[]);
RtVoid RiPointsPolygons(RtInt npolys, RtInt nverts[], RtInt verts[], ...);
RtVoid RiPointsPolygonsV(RtInt npolys, RtInt nverts[], RtInt verts[], RtInt n, RtToken tokens[],
    RtPointer parms[]);
RtVoid RiPointsGeneralPolygons(RtInt npolys, RtInt nloops[], RtInt nverts[], RtInt verts[], ...);
RtVoid RiPointsGeneralPolygonsV(RtInt npolys, RtInt nloops[], RtInt nverts[], RtInt verts[], RtInt n,
    RtToken tokens[], RtPointer parms[]);
RtVoid RiBasis(RtBasis ubasis, RtInt ustep, RtBasis vbasis, RtInt vstep);
RtVoid RiPatch(RtToken type, ...);
RtVoid RiPatchV(RtToken type, RtInt n, RtToken tokens[], RtPointer parms[]);
RtVoid RiPatchMesh(RtToken type, RtInt nu, RtToken uwrap, RtInt nv, RtToken vwrap, ...);
RtVoid RiPatchMeshV(RtToken type, RtInt nu, RtToken uwrap, RtInt nv, RtToken vwrap, RtInt n, RtToken tokens[],
    RtPointer parms[]);
RtVoid RiNuPatch(RtInt nu, RtInt uorder, RtFloat uknot[], RtFloat umin, RtFloat umax, RtInt nv, RtInt vorder,
    RtFloat vknot[], RtFloat vmin, RtFloat vmax, ...);
RtVoid RiNuPatchV(RtInt nu, RtInt uorder, RtFloat uknot[], RtFloat umin, RtFloat umax, RtInt nv, RtInt vorder,
    RtFloat vknot[], RtFloat vmin, RtFloat vmax, RtInt n, RtToken tokens[], RtPointer parms[]);
RtVoid RiTrimCurve(RtInt nloops, RtInt ncurves[], RtInt order[], RtFloat knot[], RtFloat min[], RtFloat max[],
    RtInt n[], RtFloat u[], RtFloat v[], RtFloat w[]);
RtVoid RiSubdivisionMesh(RtToken scheme, RtInt nfaces, RtInt nverts[], RtInt verts[], RtInt ntags,
    RtToken tags[], RtInt nargs[], RtInt intargs[], RtFloat floatargs[], ...);
RtVoid RiSubdivisionMeshV(RtToken scheme, RtInt nfaces, RtInt nverts[], RtInt verts[], RtInt ntags,
    RtToken tags[], RtInt nargs[], RtInt intargs[], RtFloat floatargs[], RtInt n, RtToken tokens[],
    RtPointer parms[]);
RtVoid RiHierarchicalSubdivisionMesh(RtToken scheme, RtInt nfaces, RtInt nverts[], RtInt verts[], RtInt ntags,
    RtToken tags[], RtInt nargs[], RtInt intargs[], RtFloat floatargs[], RtToken stringargs[], ...);
RtVoid RiHierarchicalSubdivisionMeshV(RtToken scheme, RtInt nfaces, RtInt nverts[], RtInt verts[],
    RtInt ntags, RtToken tags[], RtInt nargs[], RtInt intargs[], RtFloat floatargs[], RtToken stringargs[],
    RtInt n, RtToken tokens[], RtPointer parms[]);
RtVoid RiSphere(RtFloat radius, RtFloat zmin, RtFloat zmax, RtFloat thetamax, ...);
RtVoid RiSphereV(RtFloat radius, RtFloat zmin, RtFloat zmax, RtFloat thetamax, RtInt n, RtToken tokens[],
    RtPointer parms[]);
RtVoid RiCone(RtFloat height, RtFloat radius, RtFloat thetamax, ...);
RtVoid RiConeV(RtFloat height, RtFloat radius, RtFloat thetamax, RtInt n, RtToken tokens[],
    RtPointer parms[]);
RtVoid RiCylinder(RtFloat radius, RtFloat zmin, RtFloat zmax, RtFloat thetamax, ...);
RtVoid RiCylinderV(RtFloat radius, RtFloat zmin, RtFloat zmax, RtFloat thetamax, RtInt n, RtToken tokens[],
    RtPointer parms[]);
RtVoid RiHyperboloid(RtPoint point1, RtPoint point2, RtFloat thetamax, ...);
RtVoid RiHyperboloidV(RtPoint point1, RtPoint point2, RtFloat thetamax, RtInt n, RtToken tokens[],
    RtPointer parms[]);
RtVoid RiParaboloid(RtFloat rmax, RtFloat zmin, RtFloat zmax, RtFloat thetamax, ...);
RtVoid RiParaboloidV(RtFloat rmax, RtFloat zmin, RtFloat zmax, RtFloat thetamax, RtInt n, RtToken tokens[],
    RtPointer parms[]);
RtVoid RiDisk(RtFloat height, RtFloat radius, RtFloat thetamax, ...);
RtVoid RiDiskV(RtFloat height, RtFloat radius, RtFloat thetamax, RtInt n, RtToken tokens[],
    RtPointer parms[]);
RtVoid RiTorus(RtFloat majorradius, RtFloat minorradius, RtFloat phimin, RtFloat phimax, RtFloat thetamax,
    ...);
RtVoid RiTorusV(RtFloat majorradius, RtFloat minorradius, RtFloat phimin, RtFloat phimax, RtFloat thetamax,
    RtInt n, RtToken tokens[], RtPointer parms[]);
RtVoid RiPoints(RtInt npoints, ...);
RtVoid RiPointsV(RtInt npoints, RtInt n, RtToken tokens[], RtPointer parms[]);
RtVoid RiCurves(RtToken type, RtInt ncurves, RtInt nvertices[], RtToken wrap, ...);
RtVoid RiCurvesV(RtToken type, RtInt ncurves, RtInt nvertices[], RtToken wrap, RtInt n, RtToken tokens[],
    RtPointer parms[]);
RtVoid RiBlobby(RtInt nleaf, RtInt ncode, RtInt code[], RtInt nflt, RtFloat flt[], RtInt nstr, RtToken str[],
    ...);
RtVoid RiBlobbyV(RtInt nleaf, RtInt ncode, RtInt code[], RtInt nflt, RtFloat flt[], RtInt nstr, RtToken str[],
    RtInt n, RtToken tokens[], RtPointer parms[]);
RtVoid RiGeometry(RtToken type, ...);
RtVoid RiGeometryV(RtToken type, RtInt n, RtToken tokens[], RtPointer parms[]);
/* The three functions below may be given as `subdivfunc`; others are called at once, and write the geometry
 * into the place of the request. `freefunc` may be NULL. */
RtVoid RiProcedural(RtPointer data, RtBound bound, RtProcSubdivFunc subdivfunc, RtProcFreeFunc freefunc);
RtVoid RiProcedural2(RtToken subdivide, RtToken bound, ...);
RtVoid RiProcedural2V(RtToken subdivide, RtToken bound, RtInt n, RtToken tokens[], RtPointer parms[]);
RtVoid RiProcDelayedReadArchive(RtPointer data, RtFloat detail);
RtVoid RiProcRunProgram(RtPointer data, RtFloat detail);
RtVoid RiProcDynamicLoad(RtPointer data, RtFloat detail);
/* free(), for data made by malloc(). */
RtVoid RiProcFree(RtPointer data);

/* ---- Textures ---- */

RtVoid RiMakeTexture(RtString picture, RtString texture, RtToken swrap, RtToken twrap,
    RtFilterFunc filterfunc, RtFloat swidth, RtFloat twidth, ...);
RtVoid RiMakeTextureV(RtString picture, RtString texture, RtToken swrap, RtToken twrap,
    RtFilterFunc filterfunc, RtFloat swidth, RtFloat twidth, RtInt n, RtToken tokens[], RtPointer parms[]);
RtVoid RiMakeBump(RtString picture, RtString texture, RtToken swrap, RtToken twrap, RtFilterFunc filterfunc,
    RtFloat swidth, RtFloat twidth, ...);
RtVoid RiMakeBumpV(RtString picture, RtString texture, RtToken swrap, RtToken twrap, RtFilterFunc filterfunc,
    RtFloat swidth, RtFloat twidth, RtInt n, RtToken tokens[], RtPointer parms[]);
RtVoid RiMakeLatLongEnvironment(RtString picture, RtString texture, RtFilterFunc filterfunc, RtFloat swidth,
    RtFloat twidth, ...);
RtVoid RiMakeLatLongEnvironmentV(RtString picture, RtString texture, RtFilterFunc filterfunc, RtFloat swidth,
    RtFloat twidth, RtInt n, RtToken tokens[], RtPointer parms[]);
RtVoid RiMakeCubeFaceEnvironment(RtString px, RtString nx, RtString py, RtString ny, RtString pz, RtString nz,
    RtString texture, RtFloat fov, RtFilterFunc filterfunc, RtFloat swidth, RtFloat twidth, ...);
RtVoid RiMakeCubeFaceEnvironmentV(RtString px, RtString nx, RtString py, RtString ny, RtString pz,
    RtString nz, RtString texture, RtFloat fov, RtFilterFunc filterfunc, RtFloat swidth, RtFloat twidth,
    RtInt n, RtToken tokens[], RtPointer parms[]);
RtVoid RiMakeShadow(RtString picture, RtString texture, ...);
RtVoid RiMakeShadowV(RtString picture, RtString texture, RtInt n, RtToken tokens[], RtPointer parms[]);
RtVoid RiMakeOcclusion(RtInt npictures, RtString pictures[], RtString texture, ...);
RtVoid RiMakeOcclusionV(RtInt npictures, RtString pictures[], RtString texture, RtInt n, RtToken tokens[],
    RtPointer parms[]);
RtVoid RiMakeBrickMap(RtInt nclouds, RtString clouds[], RtString brickmap, ...);
RtVoid RiMakeBrickMapV(RtInt nclouds, RtString clouds[], RtString brickmap, RtInt n, RtToken tokens[],
    RtPointer parms[]);

/* ---- Archives ---- */

RtVoid RiReadArchive(RtToken name, RtArchiveCallback callback, ...);
RtVoid RiReadArchiveV(RtToken name, RtArchiveCallback callback, RtInt n, RtToken tokens[], RtPointer parms[]);
RtArchiveHandle RiArchiveBegin(RtToken name, ...);
RtArchiveHandle RiArchiveBeginV(RtToken name, RtInt n, RtToken tokens[], RtPointer parms[]);
RtVoid RiArchiveEnd(void);
/* type: RI_COMMENT, RI_STRUCTURE, RI_VERBATIM; the rest is as of printf(). */
RtVoid RiArchiveRecord(RtToken type, RtString format, ...);
RtVoid RiVArchiveRecord(RtToken type, RtString format, va_list arguments);

/* ---- Errors ---- */

/* One handler for all contexts. RiErrorAbort ends the process at errors (not at warnings). */
RtVoid RiErrorHandler(RtErrorHandler handler);
RtVoid RiErrorIgnore(RtInt code, RtInt severity, char *message);
RtVoid RiErrorPrint(RtInt code, RtInt severity, char *message);
RtVoid RiErrorAbort(RtInt code, RtInt severity, char *message);

/* ---- Filters: x and y in pixels from the middle; 0 outside of the widths is the renderer's to see to ---- */

RtFloat RiBoxFilter(RtFloat x, RtFloat y, RtFloat xwidth, RtFloat ywidth);
RtFloat RiTriangleFilter(RtFloat x, RtFloat y, RtFloat xwidth, RtFloat ywidth);
RtFloat RiCatmullRomFilter(RtFloat x, RtFloat y, RtFloat xwidth, RtFloat ywidth);
RtFloat RiGaussianFilter(RtFloat x, RtFloat y, RtFloat xwidth, RtFloat ywidth);
RtFloat RiSincFilter(RtFloat x, RtFloat y, RtFloat xwidth, RtFloat ywidth);
RtFloat RiMitchellFilter(RtFloat x, RtFloat y, RtFloat xwidth, RtFloat ywidth);
RtFloat RiDiskFilter(RtFloat x, RtFloat y, RtFloat xwidth, RtFloat ywidth);
RtFloat RiBesselFilter(RtFloat x, RtFloat y, RtFloat xwidth, RtFloat ywidth);
RtFloat RiLanczosFilter(RtFloat x, RtFloat y, RtFloat xwidth, RtFloat ywidth);
RtFloat RiBlackmanHarrisFilter(RtFloat x, RtFloat y, RtFloat xwidth, RtFloat ywidth);
RtFloat RiSeparableCatmullRomFilter(RtFloat x, RtFloat y, RtFloat xwidth, RtFloat ywidth);

#ifdef __cplusplus
}
#endif

#endif
