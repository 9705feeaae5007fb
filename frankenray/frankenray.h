/* clang-format off */
/* frankenray: ask a frankenrender ray server what a ray meets. C99, no other header of ours.
 *
 *   frankenray_session *session = frankenray_create();
 *   frankenray_start(session, NULL, "scene.rib");          or frankenray_join(session, NULL, "name")
 *   frankenray_line *line = frankenray_line_open(session); one per thread
 *   frankenray_visibility(line, from, to, color);          one ray at a time, or
 *   frankenray_answer(line, &rays, &answers);              any number of rays, or
 *   frankenray_submit / _poll / _wait / _release           the same without waiting
 *   frankenray_line_close(line);
 *   frankenray_close(session);
 *
 * SPACES AND UNITS. Everything spatial is in the world space of the scene (what holds at WorldBegin), in its
 * units. Points are doubles, so that scenes far from the origin keep their precision: they are made relative to
 * the scene cache's own origin before they are rounded to the floats with which rays are traced (a few 1e-7 of
 * the distance from that origin). Directions, normals, colours and distances are floats. Directions need not be
 * of unit length; distances are Euclidean, whatever the length of the direction. Times run from 0 (the shutter
 * opens) to 1 (it closes).
 *
 * ERRORS. Functions return FRANKENRAY_OK (0), FRANKENRAY_PENDING (1, frankenray_poll only) or a negative code; the
 * text of the last error is kept with the session, line or batch that it happened to. Nothing throws, prints, ends
 * the process or raises a signal. Null handles are FRANKENRAY_ERROR_ARGUMENT. Rays that make no sense (NaN, zero
 * direction) are not errors: they hit nothing.
 *
 * WHEN THE SERVER DIES, every line gets FRANKENRAY_ERROR_SERVER_GONE from then on, nobody waits for ever, and
 * answers that were not given are those of rays that hit nothing. frankenray_reconnect() starts or joins the same
 * server again; lines stay valid and go on with the new one.
 *
 * THREADS. Functions of a session may be called from any thread at any time, except frankenray_close. A line and its
 * batches belong to one thread at a time. Lines outlive their session: closing a session first is harmless.
 *
 * FORK. In a child of fork() (without exec) every handle of the parent answers FRANKENRAY_ERROR_FORKED, and closing
 * it only frees memory; the parent's handles are not disturbed. The child makes a session of its own.
 */
#ifndef FRANKENRAY_H
#define FRANKENRAY_H

#include <stddef.h>
#include <stdint.h>

#if defined(FRANKENRAY_BUILDING)
#define FRANKENRAY_API __attribute__((visibility("default")))
#else
#define FRANKENRAY_API
#endif

#ifdef __cplusplus
extern "C" {
#endif

/* The interface described here. Functions and fields are only added; structures say their size.
 * 2: labels, subsets, distances and classes of rays; places. */
#define FRANKENRAY_INTERFACE 2

/* The interface of the library that is loaded, and its release as text ("0.1.0"). */
FRANKENRAY_API int frankenray_interface(void);
FRANKENRAY_API const char *frankenray_version(void);

/* ---- Status ------------------------------------------------------------------------------------------------ */

enum {
  FRANKENRAY_OK = 0,
  FRANKENRAY_PENDING = 1,                 /* frankenray_poll: not all rays are answered yet */
  FRANKENRAY_ERROR_ARGUMENT = -1,         /* a null handle or array, an unknown kind, a wrong structure size */
  FRANKENRAY_ERROR_NOT_CONNECTED = -2,    /* the session was neither started nor joined */
  FRANKENRAY_ERROR_NO_SERVER = -3,        /* the program, the scene or the running server was not found */
  FRANKENRAY_ERROR_START = -4,            /* the server was started and refused (the text says why) */
  FRANKENRAY_ERROR_VERSION = -5,          /* the server is of another version; the text names both */
  FRANKENRAY_ERROR_SERVER_GONE = -6,      /* the server died or does not answer */
  FRANKENRAY_ERROR_MEMORY = -7,           /* out of memory, of shared memory or of descriptors */
  FRANKENRAY_ERROR_STATE = -8,            /* the call does not fit what was done before */
  FRANKENRAY_ERROR_FORKED = -9,           /* the handle belongs to the parent process */
  FRANKENRAY_ERROR_INTERNAL = -10         /* a fault of this library */
};
typedef int frankenray_status;

/* A constant sentence for a code, never NULL. */
FRANKENRAY_API const char *frankenray_status_text(frankenray_status status);

/* ---- Sessions: which server --------------------------------------------------------------------------------- */

typedef struct frankenray_session frankenray_session;

/* How to reach the server. Begin with FRANKENRAY_OPTIONS_INIT, then set what differs. */
typedef struct frankenray_options {
  size_t size;                   /* sizeof(frankenray_options) */
  const char *program;           /* the server's program; NULL: $FRANKENRAY_RENDRIB, else "rendrib" in the PATH */
  const char *const *arguments;  /* further arguments before the scene, ended by NULL; NULL: none */
  int threads;                   /* of the server; 0: one per core */
  int transport;                 /* FRANKENRAY_SHARED_MEMORY or FRANKENRAY_PIPE (frankenray_start only) */
} frankenray_options;
enum { FRANKENRAY_SHARED_MEMORY = 0, FRANKENRAY_PIPE = 1 };
#define FRANKENRAY_OPTIONS_INIT \
  { sizeof(frankenray_options), NULL, NULL, 0, FRANKENRAY_SHARED_MEMORY }

/* A session without a server; NULL when there is no memory. */
FRANKENRAY_API frankenray_session *frankenray_create(void);

/* Starts "rendrib -rayserver <scene>" for this session alone. `scene` is a RIB or an .fsc file. The server ends with
 * the session, however this process ends. `options` may be NULL. Returns when the server has taken the scene, or
 * refused. */
FRANKENRAY_API frankenray_status frankenray_start(frankenray_session *session, const frankenray_options *options,
                                                  const char *scene);

/* The same with a whole command line as in the environment variable RAYSERVER ("rendrib -rayserver a.rib b.rib"):
 * words at blanks, quotes ' and " and \ as in a shell, nothing else of a shell's. "@name" joins instead. */
FRANKENRAY_API frankenray_status frankenray_start_command(frankenray_session *session,
                                                          const frankenray_options *options, const char *command);

/* Joins a server that is running for this user under `name` (rendrib -rayserver -name <name>). */
FRANKENRAY_API frankenray_status frankenray_join(frankenray_session *session, const frankenray_options *options,
                                                 const char *name);

/* Leaves the server, if there still is one, and starts or joins it again as before. Lines follow at their next call;
 * batches of the former server stay failed. */
FRANKENRAY_API frankenray_status frankenray_reconnect(frankenray_session *session);

/* FRANKENRAY_OK while the server lives, else the code that a line would get. */
FRANKENRAY_API frankenray_status frankenray_state(frankenray_session *session);

/* Process id of the server, 0 while it is unknown or none runs. */
FRANKENRAY_API int frankenray_server_pid(frankenray_session *session);

/* Text of the session's last error, "" if there was none. Valid until this thread's next call with a session. */
FRANKENRAY_API const char *frankenray_error_text(frankenray_session *session);

/* Ends the session, and the server if the session started it. Lines that are still open fail from now on. NULL is
 * allowed. */
FRANKENRAY_API void frankenray_close(frankenray_session *session);

/* ---- Lines: one per thread ---------------------------------------------------------------------------------- */

typedef struct frankenray_line frankenray_line;

/* NULL when there is no memory, or session is NULL. The connection itself is made by the line's first question. */
FRANKENRAY_API frankenray_line *frankenray_line_open(frankenray_session *session);
/* Gives up its batches (those in flight are waited for, as long as the server lives). NULL is allowed. */
FRANKENRAY_API void frankenray_line_close(frankenray_line *line);
/* Text of the line's last error, "" if there was none; valid until the next call with this line. */
FRANKENRAY_API const char *frankenray_line_error_text(frankenray_line *line);

/* ---- Questions ---------------------------------------------------------------------------------------------- */

/* What is asked, as the shading language asks it. */
enum {
  FRANKENRAY_TRACE = 0,      /* color: what comes along the ray; distance: FRANKENRAY_NO_HIT_TRACE on a miss */
  FRANKENRAY_VISIBILITY = 1, /* color: 1 clear ... 0 opaque, between origin and target */
  FRANKENRAY_HITTEST = 2,    /* distance (FRANKENRAY_NO_HIT on a miss), position, normal; no shader runs */
  FRANKENRAY_FULLTRACE = 3   /* all of these, and where the deepest ray left the scene */
};
#define FRANKENRAY_NO_HIT 1.0e38f
#define FRANKENRAY_NO_HIT_TRACE 1.0e30f

/* Columns of vectors: one array per coordinate. `stride` counts elements (not bytes) from one ray to the next; 0 means
 * 1. Interleaved xyz data are x = p, y = p + 1, z = p + 2, stride = 3. */
typedef struct frankenray_points {
  const double *x, *y, *z;
  ptrdiff_t stride;
} frankenray_points;
typedef struct frankenray_vectors {
  const float *x, *y, *z;
  ptrdiff_t stride;
} frankenray_vectors;
typedef struct frankenray_points_out {
  double *x, *y, *z;
  ptrdiff_t stride;
} frankenray_points_out;
typedef struct frankenray_vectors_out {
  float *x, *y, *z;
  ptrdiff_t stride;
} frankenray_vectors_out;

/* A place on a surface of the scene: an answer tells where it hit, a question may say where it starts. A ray that
 * starts at a place leaves that surface without meeting it again by rounding or by its facets: it needs no bias. The
 * contents are the library's; copy places, keep them, and give them back to the server that they came from. All
 * bytes 0: nowhere. */
typedef struct frankenray_place {
  uint32_t opaque[8];
} frankenray_place;

/* What rays are for: it decides which surfaces let themselves be seen (Attribute "visibility"), and what
 * rayinfo("type") says at their hits. Not for FRANKENRAY_VISIBILITY: those are transmission rays. */
enum { FRANKENRAY_SPECULAR = 0, FRANKENRAY_DIFFUSE = 1 };

/* Rays as structure of arrays; any count, 0 included. Begin with FRANKENRAY_RAYS_INIT. */
typedef struct frankenray_rays {
  size_t size;                  /* sizeof(frankenray_rays) */
  int kind;                     /* FRANKENRAY_TRACE ... */
  int level;                    /* ray level of these rays: 1 for rays asked by what the camera sees */
  size_t count;
  const char *label;            /* raylabel() at what they hit, at most 51 bytes; NULL: none */
  frankenray_points origin;
  frankenray_vectors direction; /* not for FRANKENRAY_VISIBILITY */
  frankenray_points target;     /* FRANKENRAY_VISIBILITY only */
  const float *time;            /* NULL: all at 0 */
  const float *radius;          /* footprint at the origin; NULL: 0 */
  const float *spread;          /* growth of the footprint's radius per unit of distance; NULL: 0 */
  const uint64_t *seed;         /* random numbers of shaders at the hits; NULL: made from the place in the batch */
  const frankenray_place *start; /* what each ray leaves; NULL: none leaves a surface */
  const char *subset;           /* groups (Attribute "grouping" "membership") that are seen, "a,b"; at most 63 bytes; */
  const char *exclude_subset;   /* and groups that are not. NULL: everything, nothing */
  float max_distance;           /* hits farther away are none; 0: no limit. Not for FRANKENRAY_VISIBILITY */
  int ray_class;                /* FRANKENRAY_SPECULAR or FRANKENRAY_DIFFUSE */
} frankenray_rays;
#define FRANKENRAY_RAYS_INIT \
  { sizeof(frankenray_rays), FRANKENRAY_TRACE, 1, 0, NULL, {0, 0, 0, 0}, {0, 0, 0, 0}, {0, 0, 0, 0}, NULL, NULL, NULL, NULL, \
    NULL, NULL, NULL, 0, FRANKENRAY_SPECULAR }

/* Where answers go. Columns whose x is NULL (or arrays that are NULL) are not wanted; those that the kind of question
 * does not have are left alone. Begin with FRANKENRAY_ANSWERS_INIT. */
typedef struct frankenray_answers {
  size_t size;                           /* sizeof(frankenray_answers) */
  frankenray_vectors_out color;          /* trace, visibility, fulltrace */
  float *distance;                       /* trace, hittest, fulltrace */
  frankenray_points_out position;        /* hittest, fulltrace; (0,0,0) on a miss */
  frankenray_vectors_out normal;         /* hittest, fulltrace: as the surface has it, not turned to the ray */
  float *miss_depth;                     /* fulltrace: level of the deepest ray that missed everything, 0: none did */
  frankenray_points_out miss_position;   /* fulltrace: where that ray started */
  frankenray_vectors_out miss_direction; /* fulltrace: and where it went */
  frankenray_place *place;               /* hittest, fulltrace: where `position` lies; nowhere on a miss */
} frankenray_answers;
#define FRANKENRAY_ANSWERS_INIT \
  { sizeof(frankenray_answers), {0, 0, 0, 0}, NULL, {0, 0, 0, 0}, {0, 0, 0, 0}, NULL, {0, 0, 0, 0}, {0, 0, 0, 0}, NULL }

/* Asks and waits. Answers are those of single rays, bit for bit, whatever else is in the batch. */
FRANKENRAY_API frankenray_status frankenray_answer(frankenray_line *line, const frankenray_rays *rays,
                                                   const frankenray_answers *answers);

/* Questions in flight. */
typedef struct frankenray_batch frankenray_batch;

/* Hands over as many of the rays as the line has room for; the others follow during frankenray_poll and
 * frankenray_wait of any batch of this line, in order. The structures are copied, the arrays they name are not: they
 * must stay, and inputs unchanged, until the batch is done. On success *batch is to be released. */
FRANKENRAY_API frankenray_status frankenray_submit(frankenray_line *line, const frankenray_rays *rays,
                                                   const frankenray_answers *answers, frankenray_batch **batch);
/* FRANKENRAY_PENDING, FRANKENRAY_OK when every answer stands in its place, or the batch's error. Never blocks. */
FRANKENRAY_API frankenray_status frankenray_poll(frankenray_batch *batch);
/* Sleeps until the batch is done. FRANKENRAY_OK or the batch's error. */
FRANKENRAY_API frankenray_status frankenray_wait(frankenray_batch *batch);
/* Frees the batch; one that is still in flight is waited for. NULL is allowed. */
FRANKENRAY_API void frankenray_release(frankenray_batch *batch);

/* One ray, with the least delay: a mailbox of two cache lines instead of a block, unless it has a label, a subset, a
 * distance or a class. Fields as in frankenray_rays. */
typedef struct frankenray_ray {
  size_t size; /* sizeof(frankenray_ray) */
  int kind;
  int level;
  double origin[3];
  double direction[3]; /* FRANKENRAY_VISIBILITY: the target, a point */
  float time, radius, spread;
  uint64_t seed;
  const char *label;
  frankenray_place start;
  const char *subset;
  const char *exclude_subset;
  float max_distance;
  int ray_class;
} frankenray_ray;
#define FRANKENRAY_RAY_INIT \
  { sizeof(frankenray_ray), FRANKENRAY_TRACE, 1, {0, 0, 0}, {0, 0, 0}, 0, 0, 0, 0, NULL, {{0, 0, 0, 0, 0, 0, 0, 0}}, NULL, NULL, \
    0, FRANKENRAY_SPECULAR }

typedef struct frankenray_hit {
  size_t size; /* sizeof(frankenray_hit) */
  float color[3];
  float distance;
  double position[3];
  float normal[3];
  float miss_depth;
  double miss_position[3];
  float miss_direction[3];
  frankenray_place place; /* hittest, fulltrace */
} frankenray_hit;
#define FRANKENRAY_HIT_INIT \
  { sizeof(frankenray_hit), {0, 0, 0}, 0, {0, 0, 0}, {0, 0, 0}, 0, {0, 0, 0}, {0, 0, 0}, {{0, 0, 0, 0, 0, 0, 0, 0}} }

/* Fields that the kind does not have are set to 0. On an error the answer is that of a ray that hits nothing. */
FRANKENRAY_API frankenray_status frankenray_ask(frankenray_line *line, const frankenray_ray *ray,
                                                frankenray_hit *hit);

/* The same for the usual cases: time 0, no footprint, no label. */
FRANKENRAY_API frankenray_status frankenray_trace(frankenray_line *line, const double origin[3],
                                                  const double direction[3], float color[3]);
FRANKENRAY_API frankenray_status frankenray_visibility(frankenray_line *line, const double from[3],
                                                       const double to[3], float color[3]);
/* position and normal are written on a hit only, and may be NULL. */
FRANKENRAY_API frankenray_status frankenray_rayhittest(frankenray_line *line, const double origin[3],
                                                       const double direction[3], float *distance,
                                                       double position[3], float normal[3]);
FRANKENRAY_API frankenray_status frankenray_fulltrace(frankenray_line *line, const double origin[3],
                                                      const double direction[3], frankenray_hit *hit);

/* ---- Statistics --------------------------------------------------------------------------------------------- */

typedef struct frankenray_statistics {
  size_t size;                /* sizeof(frankenray_statistics) */
  uint64_t rays[4];           /* asked by this session, by kind; single ones included */
  uint64_t single_rays;       /* of these, one at a time */
  uint64_t blocks;            /* that carried the others */
  uint64_t connections;       /* servers started or joined so far */
  uint64_t server_rays[4];    /* asked by all clients of the server, by kind */
  uint64_t server_nested[4];  /* asked by shaders at hits */
  uint64_t server_hits_shaded;
  uint64_t server_bytes;      /* of its ray tree and records */
} frankenray_statistics;

/* Counts so far. The server's are 0 when it does not tell. Set size first. */
FRANKENRAY_API frankenray_status frankenray_read_statistics(frankenray_session *session,
                                                            frankenray_statistics *statistics);

#ifdef __cplusplus
}
#endif
#endif
