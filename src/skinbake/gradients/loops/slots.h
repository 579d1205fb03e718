/* The slots that gradients go to, joints that are adopted, and the gradients of one vertex (twin: slots.py). */

#pragma once

#include "frames.h"

static int by_joint(const void *a, const void *b)
{
    const Entry *first = a, *second = b;
    return (first->joint > second->joint) - (first->joint < second->joint);
}

/* Up to this number of entries, insertion is the fastest way to sort. */
enum { FEW = 32 };

/* The numbers of entries and foreign entries of a class in the scratch, and the sum of the entries' magnitudes. */
typedef struct {
    size_t entries, foreign;
    size_t capacity; /* joints that each of the class's vertices may adopt */
    size_t turnings; /* joints that turn */
    int32_t used;    /* local numbers */
    double magnitude;
} ClassGradients;

/* Turn sums into entries, joints ascending. Return their number, and the sum of their magnitudes. */
static ALWAYS_INLINE size_t make_entries(Scratch *w, int32_t used, double total, double *magnitudes)
{
    size_t count = 0;
    double mean = 1.0 / total;
    for (int32_t n = 0; n < used; n++) {
        /* The mean over all corners; joints whose sum is 0 have no entry. */
        Vector g = {w->x[n] * mean, w->y[n] * mean, w->z[n] * mean};
        if (w->met[n] < 0 || (w->x[n] == 0.0 && w->y[n] == 0.0 && w->z[n] == 0.0))
            continue;
        /* Sorted by joint, few of them by insertion. */
        size_t at = count++;
        for (; used <= FEW && at > 0 && w->entries[at - 1].joint > w->met[n]; at--)
            w->entries[at] = w->entries[at - 1];
        w->entries[at] = (Entry){w->met[n], n, 0, g, sqrt(dot(g, g))};
    }
    if (used > FEW)
        qsort(w->entries, count, sizeof *w->entries, by_joint);
    *magnitudes = 0.0;
    for (size_t n = 0; n < count; n++)
        *magnitudes += w->entries[n].magnitude;
    return count;
}

static int by_magnitude(const void *a, const void *b)
{
    const Entry *first = *(Entry *const *)a, *second = *(Entry *const *)b;
    if (first->magnitude != second->magnitude)
        return first->magnitude > second->magnitude ? -1 : 1;
    return (first->joint > second->joint) - (first->joint < second->joint);
}

/* Collect the entries that are worth a slot, and whose joints the class does not have. The largest is first. */
static ALWAYS_INLINE size_t find_foreign(const Surface *s, size_t entries, double magnitudes, Scratch *w)
{
    size_t count = 0;
    for (size_t n = 0; n < entries; n++) {
        Entry *entry = &w->entries[n];
        /* The class has the joint if one of its slots gives it a weight. */
        int own = entry->local < (int32_t)s->slots && w->own[entry->local] > 0.0;
        if (!own && entry->magnitude > s->negligible * magnitudes)
            w->foreign[count++] = entry;
    }
    if (count > 1)
        qsort(w->foreign, count, sizeof *w->foreign, by_magnitude);
    return count;
}

/* Fill `named`, and the adopted joints of one vertex. Return whether it adopts any. */
static inline int name_slots(const Surface *s, size_t vertex, const ClassGradients *found, Scratch *w,
                             int32_t *adopted)
{
    const size_t slots = (size_t)s->slots;
    const int32_t *joints = s->joints + vertex * slots;
    const uint8_t *free_slots = s->free_slots + vertex * slots;
    size_t moved = 0, wanted = found->foreign < found->capacity ? found->foreign : found->capacity;
    memcpy(w->named, joints, slots * sizeof *joints);
    /* The largest foreign gradient takes the first free slot. */
    for (size_t k = 0; k < slots && moved < wanted; k++)
        if (free_slots[k]) {
            w->named[k] = w->foreign[moved++]->joint;
            adopted[k] = w->named[k] + 1;
        }
    for (size_t k = 0; moved && k < slots; k++)
        for (size_t n = 0; adopted[k] == 0 && n < moved; n++)
            if (joints[k] == w->foreign[n]->joint)
                w->named[k] = NO_JOINT; /* its joint has moved into another slot */
    return moved > 0;
}

/* A number as it is stored. A zero has no sign, so that arrays of equal numbers have equal bits. */
static ALWAYS_INLINE float stored(double value) { return (float)value + 0.0f; }

/* The slots that a vertex's gradients go to: by `named`, or by the local numbers. The local numbers hold for a
   class's first vertex if it adopts nothing. */
typedef enum { AS_NAMED, AS_NUMBERED } Placing;

/* Write alpha and beta of one vertex. Return the magnitude that its slots do not hold. */
static ALWAYS_INLINE double project(const Surface *s, size_t slots, size_t vertex, size_t entries, Placing placing,
                                    const Baked *out, Scratch *w)
{
    Vector t, b;
    find_frame(s, vertex, &w->latest, &t, &b);
    float *alpha = out->alpha + vertex * (slots - 1), *beta = out->beta + vertex * (slots - 1);
    double unheld = 0.0;
    memset(alpha, 0, (slots - 1) * sizeof *alpha);
    memset(beta, 0, (slots - 1) * sizeof *beta);
    for (size_t n = 0; n < entries; n++) {
        Entry *entry = &w->entries[n];
        /* The slot that names the joint, if there is one. */
        size_t slot = (size_t)entry->local;
        if (placing == AS_NAMED)
            for (slot = 0; slot < slots && w->named[slot] != entry->joint;)
                slot++;
        entry->held = slot < slots;
        if (!entry->held) {
            unheld += entry->magnitude;
        } else if (slot > 0) {
            alpha[slot - 1] = stored(dot(entry->gradient, t));
            beta[slot - 1] = stored(dot(entry->gradient, b));
        }
    }
    return unheld;
}
