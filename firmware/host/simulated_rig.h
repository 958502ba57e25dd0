/* A rig that a computer simulates around the firmware: arms, lamp and camera line on a virtual clock. */
#ifndef SIMULATED_RIG_H
#define SIMULATED_RIG_H

#include "kinran_rig.h"

/* What happens to the rig; tests/helpers/c_rig.py has the same list. */
enum happening {
    DOOR_OPEN,
    DOOR_CLOSED,
    LIMIT_SWITCH,
    BLOCKED,
    LAMP_OUT,
    OVERHEATED,
    X_SYNC_OUT,
    X_SYNC_IN,
    EXPOSURE,
    POWER_CYCLE
};

struct simulation;

/* A rig from its maker, just switched on; NULL where there is no memory. */
struct simulation *simulation_create(uint32_t seed);
void simulation_destroy(struct simulation *sim);

void simulation_write(struct simulation *sim, const uint8_t *data, size_t length);
/* Take the oldest input report; false where there is none. */
bool simulation_read(struct simulation *sim, uint8_t report[RIG_REPORT]);
bool simulation_get_feature(struct simulation *sim, uint8_t id, uint8_t report[RIG_REPORT]);
bool simulation_set_feature(struct simulation *sim, const uint8_t *data, size_t length);
void simulation_advance(struct simulation *sim, uint32_t ms);
void simulation_happen(struct simulation *sim, enum happening happening, uint8_t axis);
/* The bytes of the report descriptor. */
const uint8_t *simulation_descriptor(size_t *length);

#endif
