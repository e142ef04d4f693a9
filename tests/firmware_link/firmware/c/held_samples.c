/* Watches that the main loop changes what sounds only while samples are held back: elsewhere the interrupt of a board
 * might find it half changed. Added to the library of `make host` by the tests (compiled_core.py); one device at a time. */
#include <string.h>

#include "device.h"

void held_samples_watch(void *host);
void held_samples_look(void);
uint32_t held_samples_faults(void);

static struct tactable_device *device;
static struct synthesis seen;
static bool are_held;
static uint32_t faults;

/* Samples change what sounds too: then there is nothing to compare with. */
static bool has_changed(void)
{
    return seen.samples == device->synthesis.samples && memcmp(&seen, &device->synthesis, sizeof seen) != 0;
}

static void hold(void *context)
{
    (void)context;
    faults += are_held || has_changed();
    are_held = true;
}

static void release(void *context)
{
    (void)context;
    faults += !are_held;
    are_held = false;
    held_samples_look();
}

/* Watches a device of host.c, which is the first member of its `struct host`, from now on. */
void held_samples_watch(void *host)
{
    device = host;
    device->hooks.hold_samples = hold;
    device->hooks.release_samples = release;
    are_held = false;
    faults = 0;
    held_samples_look();
}

/* No sample runs between this and what is watched next. */
void held_samples_look(void)
{
    memcpy(&seen, &device->synthesis, sizeof seen);
}

/* Since the watch began: holds within a hold, releases of nothing, and changes that were not held back. */
uint32_t held_samples_faults(void)
{
    faults += are_held || has_changed();
    return faults;
}
