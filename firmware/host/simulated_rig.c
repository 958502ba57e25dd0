#include "simulated_rig.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#define QUEUE 512u /* reports that wait for the host; the oldest is lost when one more comes */
#define HOMING_MS 5000u
#define PHOTODIODE 100000.0 /* counts at the lamp's nominal light */

struct simulation {
    struct rig rig;
    struct rig_hardware hw;
    uint32_t now, entropy;
    uint8_t queue[QUEUE][RIG_REPORT];
    unsigned first, queued;
    uint8_t kept[RIG_PAYLOAD];
    bool has_kept;
    int32_t position[RIG_AXES];
    bool seeking[RIG_AXES], blocked[RIG_AXES], pressed[RIG_AXES];
    uint32_t sought[RIG_AXES];
    bool door, lamp, cable;
    uint32_t lit, edges;
};

static const struct rig_maker MAKER = {
    .serial = "OGM-SIMULATED",
    .firmware = 1,
    .capabilities = RIG_X_SYNC,
    .config =
        {
            .low = {0, -10000, -75000, -360000},
            .high = {90000, 370000, 75000, 360000},
            .speed = {1000, 3000, 1000, 3000},
            .acceleration = {20, 60, 20, 60},
            .watchdog_ms = 2000,
            .homing_s = 5,
        },
};

static uint32_t random_number(void *context) {
    struct simulation *sim = context;
    sim->entropy = sim->entropy * 1664525u + 1013904223u; /* Numerical Recipes' generator: no two alike in a row */
    return sim->entropy;
}

static void drive(void *context, unsigned axis, int32_t mdeg) {
    struct simulation *sim = context;
    if (!sim->blocked[axis])
        sim->position[axis] = mdeg;
}

static int32_t position(void *context, unsigned axis) {
    return ((struct simulation *)context)->position[axis];
}

static void seek(void *context, unsigned axis) {
    struct simulation *sim = context;
    sim->seeking[axis] = true;
    sim->sought[axis] = sim->now;
    sim->blocked[axis] = sim->pressed[axis] = false; /* somebody has looked after it */
}

static bool found(void *context, unsigned axis) {
    struct simulation *sim = context;
    if (sim->seeking[axis] && !sim->blocked[axis] && sim->now - sim->sought[axis] >= HOMING_MS) {
        sim->seeking[axis] = false;
        sim->position[axis] = 0;
    }
    return !sim->seeking[axis];
}

static void halt(void *context) {
    memset(((struct simulation *)context)->seeking, 0, sizeof(bool[RIG_AXES]));
}

static bool at_limit(void *context, unsigned axis) {
    return ((struct simulation *)context)->pressed[axis];
}

static bool door_open(void *context) {
    return ((struct simulation *)context)->door;
}

static void lamp(void *context, bool on) {
    struct simulation *sim = context;
    if (on && !sim->lamp)
        sim->lit = sim->now;
    sim->lamp = on;
}

static void shutter(void *context, bool open) {
    (void)context;
    (void)open;
}

/* The xenon lamp of workflow/kinran/rig/machine.py: it warms up, breathes and ages. */
static uint32_t photodiode(void *context) {
    struct simulation *sim = context;
    double s = (sim->now - sim->lit) / 1000.0;
    double breathing = 0.004 * sin(2 * 3.14159265358979323846 * s / 1500) + 0.002 * sin(s / 37);
    double output = 1 - 0.15 * exp(-s / 300) + breathing - 0.01 * s / 36000;
    return sim->lamp ? (uint32_t)lround(PHOTODIODE * output) : 0;
}

static void release(void *context, uint32_t open_us) {
    struct simulation *sim = context;
    if (open_us && sim->cable)
        sim->edges++;
}

static uint32_t x_sync(void *context) {
    return ((struct simulation *)context)->edges;
}

static void send(void *context, const uint8_t report[RIG_REPORT]) {
    struct simulation *sim = context;
    memcpy(sim->queue[(sim->first + sim->queued) % QUEUE], report, RIG_REPORT);
    if (sim->queued < QUEUE)
        sim->queued++;
    else
        sim->first = (sim->first + 1) % QUEUE;
}

static void keep(void *context, const uint8_t config[RIG_PAYLOAD]) {
    struct simulation *sim = context;
    memcpy(sim->kept, config, RIG_PAYLOAD);
    sim->has_kept = true;
}

static void start(struct simulation *sim, uint8_t cause) {
    rig_init(&sim->rig, &sim->hw, &MAKER, sim->has_kept ? sim->kept : NULL, cause, sim->now);
}

struct simulation *simulation_create(uint32_t seed) {
    struct simulation *sim = calloc(1, sizeof *sim);
    if (!sim)
        return NULL;
    sim->hw = (struct rig_hardware){
        .context = sim,
        .random = random_number,
        .drive = drive,
        .position = position,
        .seek = seek,
        .found = found,
        .halt = halt,
        .at_limit = at_limit,
        .door_open = door_open,
        .lamp = lamp,
        .shutter = shutter,
        .photodiode = photodiode,
        .release = release,
        .x_sync = x_sync,
        .send = send,
        .keep = keep,
    };
    sim->entropy = seed;
    sim->now = 0u - 10000u; /* the clock wraps around ten seconds after the start */
    sim->position[0] = 20000;
    sim->position[1] = 15000;
    sim->cable = true;
    start(sim, 0);
    return sim;
}

void simulation_destroy(struct simulation *sim) {
    free(sim);
}

void simulation_write(struct simulation *sim, const uint8_t *data, size_t length) {
    rig_output(&sim->rig, data, length);
}

bool simulation_read(struct simulation *sim, uint8_t report[RIG_REPORT]) {
    if (!sim->queued)
        return false;
    memcpy(report, sim->queue[sim->first], RIG_REPORT);
    sim->first = (sim->first + 1) % QUEUE;
    sim->queued--;
    return true;
}

bool simulation_get_feature(struct simulation *sim, uint8_t id, uint8_t report[RIG_REPORT]) {
    return rig_get_feature(&sim->rig, id, report);
}

bool simulation_set_feature(struct simulation *sim, const uint8_t *data, size_t length) {
    return rig_set_feature(&sim->rig, data, length);
}

void simulation_advance(struct simulation *sim, uint32_t ms) {
    while (ms--)
        rig_tick(&sim->rig, ++sim->now);
}

void simulation_happen(struct simulation *sim, enum happening happening, uint8_t axis) {
    switch (happening) {
    case DOOR_OPEN:
    case DOOR_CLOSED:
        sim->door = happening == DOOR_OPEN;
        break;
    case LIMIT_SWITCH:
        sim->pressed[axis] = true;
        break;
    case BLOCKED:
        sim->blocked[axis] = true;
        break;
    case LAMP_OUT:
        rig_trip(&sim->rig, RIG_FAULT_LAMP_OUT, RIG_NO_AXIS);
        break;
    case OVERHEATED:
        rig_trip(&sim->rig, RIG_FAULT_OVERHEATED, RIG_NO_AXIS);
        break;
    case X_SYNC_OUT:
    case X_SYNC_IN:
        sim->cable = happening == X_SYNC_IN;
        break;
    case EXPOSURE:
        release(sim, 1);
        break;
    case POWER_CYCLE:
        start(sim, 2);
        break;
    }
    rig_tick(&sim->rig, sim->now);
}

const uint8_t *simulation_descriptor(size_t *length) {
    static const uint8_t descriptor[] = {RIG_DESCRIPTOR};
    *length = sizeof descriptor;
    return descriptor;
}
