"""C text of the observer and the actuators of a designed controller. NAME_ is later replaced by the model's prefix."""

HEADER = """\
/* {title}

   Call at every sample, with the newest outputs y (m from rest) and the input that acted since the sample before:

       NAME_observe(&observer, y, acting);          state observer.z, disturbance observer.d of the outputs, m
       ...if it returns NAME_LOST: NAME_observe_restart with the result of NAME_encode on your window of y - d...
       ...your own program plans with NAME_horizon and gives the command...
       NAME_actuator(&actuators, command, acting);  acting: the input that acts until the next sample

   All functions are re-entrant, allocate nothing, and agree with the Python controller to rounding.
   The quadratic program is not in this file. Sampling time: {timestep} s. Controller: {facts}.
*/
#ifndef NAME_CONTROLLER_H
#define NAME_CONTROLLER_H

#include "NAME.h"

#ifdef __cplusplus
extern "C" {{
#endif

/* z (n): state, d (p): disturbance; the other fields are internal. */
typedef struct {{
    double z[{n}], d[{p}], scale;
    int shut, strange, begun, unloaded, gap;
}} NAME_observer;

/* For each input: what the last command transmits, and the values that are still delayed. */
typedef struct {{
    double transmitted[{m}], limited[{m}], lagged[{m}], queue[{room}];
    int oldest;
}} NAME_actuators;

/* Return codes of NAME_observe. */
enum {{ NAME_UPDATED = 0, NAME_MISSING = 1, NAME_GATED = 2, NAME_LOST = 3 }};

/* Call before the first sample, and to start again. */
void NAME_observe_reset(NAME_observer *observer);

/* Call after a gap in time: the disturbance is kept, the state comes from the next window. */
void NAME_observe_forget(NAME_observer *observer);

/* One sample: y (p), not finite where it is missing; acting (m), the input that acted since the last sample. NAME_LOST:
   the state is outside the recorded range and mispredicts, or there was a gap in time. Then call NAME_observe_restart
   with the result of NAME_encode on your newest window, whose outputs are y - d with the d after each sample. */
int NAME_observe(NAME_observer *observer, const double *y, const double *acting);

/* Set the state to z (n) from a chart, clipped to the recorded range; d is kept. A z that is not finite is ignored. */
void NAME_observe_restart(NAME_observer *observer, const double *z);

/* Set the actuators to their state under a constant command (m); acting (m) is the input that then acts. */
void NAME_actuator_rest(NAME_actuators *actuators, const double *command, double *acting);

/* Give the command (m) of this sample; acting (m) is the input that acts until the next one. */
void NAME_actuator(NAME_actuators *actuators, const double *command, double *acting);

#ifdef __cplusplus
}}
#endif

#endif
"""

OBSERVER = """\
static double within(double value, double most)
{
    return value < -most ? -most : value > most ? most : value;
}

static int inside(const double *z, const double *most)
{
    int i;
    for (i = 0; i < N; i++)
        if (!(fabs(z[i]) <= most[i]))
            return 0;
    return 1;
}

/* Whether an innovation with this squared distance passes the outlier gate. */
static int passes(NAME_observer *observer, double distance)
{
    const double widest = SIGMAS_SQUARED * observer->scale;
    double least = distance < widest ? distance : widest;
    if (!isfinite(distance))
        return 0;
    if (distance > widest && observer->shut < MOST_IN_A_ROW) {
        observer->shut++;
        return 0;
    }
    observer->shut = 0;
    if (least < MEMORY * observer->scale)
        least = MEMORY * observer->scale;
    observer->scale = least > 1.0 ? least : 1.0;
    return 1;
}

void NAME_observe_reset(NAME_observer *observer)
{
    int i;
    for (i = 0; i < N; i++)
        observer->z[i] = 0.0;
    for (i = 0; i < P; i++)
        observer->d[i] = 0.0;
    observer->begun = 0;
    observer->unloaded = 1;
    NAME_observe_forget(observer);
}

void NAME_observe_forget(NAME_observer *observer)
{
    observer->scale = AT_FIRST;
    observer->shut = observer->strange = 0;
    observer->gap = observer->begun;
}

void NAME_observe_restart(NAME_observer *observer, const double *z)
{
    int i;
    for (i = 0; i < N; i++)
        if (!isfinite(z[i]))
            return;
    for (i = 0; i < N; i++)
        observer->z[i] = within(z[i], range[i]);
    observer->scale = AT_FIRST;
    observer->shut = 0;
    observer->strange = -PATIENCE;
}

/* Set z to the model's rest under the acting input. */
static void begin(NAME_observer *observer, const double *acting)
{
    double window[(D + 1) * P], inputs[(D + 1) * M], start[N];
    int i, k;
    for (i = 0; i < (D + 1) * P; i++)
        window[i] = 0.0;
    for (k = 0; k <= D; k++)
        for (i = 0; i < M; i++)
            inputs[k * M + i] = acting[i];
    NAME_encode(window, inputs, start);
    for (i = 0; i < N; i++)
        observer->z[i] = start[i];
    for (k = 0; k < SETTLING; k++)
        NAME_step(observer->z, acting, observer->z);
    if (!inside(observer->z, beyond))
        for (i = 0; i < N; i++)
            observer->z[i] = within(start[i], range[i]);
    observer->begun = 1;
}

/* Correct z and d by the innovation e. */
static void correct(NAME_observer *observer, const double *e)
{
    int i, j, mispredicts = 0;
    for (i = 0; i < N + P; i++) {
        double change = 0.0;
        for (j = 0; j < P; j++)
            change += gain[i * P + j] * e[j];
        if (i < N)
            observer->z[i] += change;
        else
            observer->d[i - N] = within(observer->d[i - N] + change, limit[i - N]);
    }
    for (i = 0; i < WATCHED; i++)
        mispredicts = mispredicts || fabs(e[watched[i]]) > LOST;
    observer->strange = mispredicts && !inside(observer->z, beyond) ? observer->strange + 1 : 0;
}

/* Correct z and d when y was measured and `output` predicted; returns what NAME_observe returns. */
static int update(NAME_observer *observer, const double *y, const double *output)
{
    double e[P], distance = 0.0;
    int i, j;
    for (i = 0; i < P; i++)
        e[i] = y[i] - output[i] - observer->d[i];
    for (i = 0; i < P; i++)
        for (j = 0; j < P; j++)
            distance += e[i] * precision[i * P + j] * e[j];
    if (passes(observer, distance / P)) {
        correct(observer, e);
        return NAME_UPDATED;
    }
    observer->strange = inside(observer->z, beyond) ? 0 : observer->strange + 1;
    return NAME_GATED;
}

int NAME_observe(NAME_observer *observer, const double *y, const double *acting)
{
    double output[P];
    int i, whole = 1, said = NAME_UPDATED;
    for (i = 0; i < P; i++)
        whole = whole && isfinite(y[i]);
    if (observer->begun)
        NAME_step(observer->z, acting, observer->z);
    else
        begin(observer, acting);
    NAME_decode(observer->z, output);
    if (!whole) {
        said = NAME_MISSING;
    } else if (observer->unloaded) {
        for (i = 0; i < P; i++)
            observer->d[i] = within(y[i] - output[i], limit[i]);
        observer->unloaded = 0;
    } else if (!observer->gap) {
        said = update(observer, y, output);
    }
    if (observer->gap && whole) {
        observer->gap = 0;
        return NAME_LOST;
    }
    return observer->strange > STRANGE || !inside(observer->z, far) ? NAME_LOST : said;
}

"""

ACTUATORS = """\
void NAME_actuator_rest(NAME_actuators *actuators, const double *command, double *acting)
{
    int i, k;
    for (i = 0; i < M; i++) {
        actuators->transmitted[i] = actuators->limited[i] = actuators->lagged[i] = command[i];
        for (k = 0; k < DELAY; k++)
            actuators->queue[k * M + i] = command[i];
        acting[i] = factor[i] * command[i] + shift[i];
    }
    actuators->oldest = 0;
}

void NAME_actuator(NAME_actuators *actuators, const double *command, double *acting)
{
    int i;
    for (i = 0; i < M; i++) {
        const double less = command[i] * LESS, more = command[i] * MORE;
        const double low = (less < more ? less : more) - half[i], high = (less < more ? more : less) + half[i];
        double given = actuators->transmitted[i];
        given = !RUBS ? command[i] : given < low ? low : given > high ? high : given;
        actuators->transmitted[i] = given;
        if (LIMITED) {
            if (given < actuators->limited[i] - stride[i])
                given = actuators->limited[i] - stride[i];
            if (given > actuators->limited[i] + stride[i])
                given = actuators->limited[i] + stride[i];
        }
        actuators->limited[i] = given;
        if (DELAY > 0) {
            const double late = actuators->queue[actuators->oldest * M + i];
            actuators->queue[actuators->oldest * M + i] = given;
            given = late;
        }
        actuators->lagged[i] = SHARE * actuators->lagged[i] + (1.0 - SHARE) * given;
        acting[i] = factor[i] * actuators->lagged[i] + shift[i];
    }
    if (DELAY > 0)
        actuators->oldest = (actuators->oldest + 1) % ROOM;
}
"""
