/* Draws how far away things are: a picture of a RIB or .fsc scene in one batch of rays, from C.
 *
 *   depthmap scene.rib picture.pgm  eye_x eye_y eye_z  at_x at_y at_z  [width height]
 *   depthmap @name     picture.pgm  ...                joins the ray server of that name instead
 *
 * Near is bright. Build: cc depthmap.c $(pkg-config --cflags --libs frankenray) -lm
 */
#include <frankenray.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>

static double eye[3], at[3];

static int complain(frankenray_session *session, frankenray_status status)
{
    fprintf(stderr, "depthmap: %s: %s\n", frankenray_status_text(status), frankenray_error_text(session));
    return 1;
}

static void normalize(double v[3])
{
    double length = sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2]);
    int c;
    for (c = 0; c < 3; ++c) v[c] = length > 0 ? v[c] / length : 0;
}

static void cross(const double a[3], const double b[3], double out[3])
{
    out[0] = a[1] * b[2] - a[2] * b[1];
    out[1] = a[2] * b[0] - a[0] * b[2];
    out[2] = a[0] * b[1] - a[1] * b[0];
}

/* Directions through the pixels of a picture, 45 degrees high, y up. */
static void aim(float *directions, int width, int height)
{
    const double up[3] = {0, 1, 0};
    double forward[3], right[3], top[3];
    int x, y, c;
    for (c = 0; c < 3; ++c) forward[c] = at[c] - eye[c];
    normalize(forward);
    cross(up, forward, right);
    normalize(right);
    cross(forward, right, top);
    for (y = 0; y < height; ++y)
        for (x = 0; x < width; ++x)
            for (c = 0; c < 3; ++c)
                directions[3 * (y * width + x) + c] =
                    (float)(forward[c] + 0.41421356 * ((2 * x + 1 - width) * right[c] +
                                                       (height - 2 * y - 1) * top[c]) / height);
}

static int writePicture(const char *name, const float *distances, int width, int height)
{
    FILE *file = fopen(name, "wb");
    float nearest = 1e30f, farthest = 0;
    int i;
    if (!file) {
        perror(name);
        return 1;
    }
    for (i = 0; i < width * height; ++i)
        if (distances[i] < FRANKENRAY_NO_HIT) {
            if (distances[i] < nearest) nearest = distances[i];
            if (distances[i] > farthest) farthest = distances[i];
        }
    fprintf(file, "P5 %d %d 255\n", width, height);
    for (i = 0; i < width * height; ++i) {
        float range = farthest > nearest ? farthest - nearest : 1;
        int grey = distances[i] < FRANKENRAY_NO_HIT ? 255 - (int)(200 * (distances[i] - nearest) / range) : 0;
        putc(grey, file);
    }
    printf("nearest %g, farthest %g\n", (double)nearest, (double)farthest);
    return fclose(file) != 0;
}

int main(int argc, char **argv)
{
    frankenray_session *session = frankenray_create();
    frankenray_line *line;
    frankenray_rays rays = FRANKENRAY_RAYS_INIT;
    frankenray_answers answers = FRANKENRAY_ANSWERS_INIT;
    frankenray_batch *batch = NULL;
    frankenray_statistics statistics;
    frankenray_status status;
    int width, height, c, failed;
    size_t i, count;
    double *origins;
    float *directions, *distances;

    if (argc != 9 && argc != 11) {
        fputs("usage: depthmap scene.rib|@server picture.pgm eye_x eye_y eye_z at_x at_y at_z [width height]\n",
              stderr);
        return 2;
    }
    for (c = 0; c < 3; ++c) eye[c] = atof(argv[3 + c]), at[c] = atof(argv[6 + c]);
    width = argc == 11 ? atoi(argv[9]) : 160;
    height = argc == 11 ? atoi(argv[10]) : 120;
    if (width < 1 || height < 1 || width > 10000 || height > 10000) return 2;
    count = (size_t)width * (size_t)height;

    status = argv[1][0] == '@' ? frankenray_join(session, NULL, argv[1] + 1)
                               : frankenray_start(session, NULL, argv[1]);
    if (status != FRANKENRAY_OK) return complain(session, status);
    line = frankenray_line_open(session);

    origins = malloc(count * 3 * sizeof *origins);
    directions = malloc(count * 3 * sizeof *directions);
    distances = malloc(count * sizeof *distances);
    if (!line || !origins || !directions || !distances) return 1;
    for (i = 0; i < count; ++i)
        for (c = 0; c < 3; ++c) origins[3 * i + (size_t)c] = eye[c];
    aim(directions, width, height);

    rays.kind = FRANKENRAY_HITTEST;
    rays.count = count;
    rays.origin.x = origins, rays.origin.y = origins + 1, rays.origin.z = origins + 2, rays.origin.stride = 3;
    rays.direction.x = directions, rays.direction.y = directions + 1, rays.direction.z = directions + 2;
    rays.direction.stride = 3;
    answers.distance = distances;
    status = frankenray_submit(line, &rays, &answers, &batch);
    while (status == FRANKENRAY_OK && (status = frankenray_poll(batch)) == FRANKENRAY_PENDING) {
        /* A program with other work does some of it here; this one has none. */
        status = frankenray_wait(batch);
    }
    frankenray_release(batch);
    if (status != FRANKENRAY_OK) {
        fprintf(stderr, "depthmap: %s\n", frankenray_line_error_text(line));
        return 1;
    }

    statistics.size = sizeof statistics;
    if (frankenray_read_statistics(session, &statistics) == FRANKENRAY_OK)
        printf("%lu rays in %lu blocks\n", (unsigned long)statistics.rays[FRANKENRAY_HITTEST],
               (unsigned long)statistics.blocks);
    failed = writePicture(argv[2], distances, width, height);
    free(origins);
    free(directions);
    free(distances);
    frankenray_line_close(line);
    frankenray_close(session);
    return failed;
}
