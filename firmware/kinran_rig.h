/* The device's side of the rig protocol (docs/rig.md): reports in, reports out, jobs, faults, motion.
 *
 * The core is C99. It allocates nothing, waits for nothing and knows no operating system: all that is physical goes
 * through the functions of `struct rig_hardware`. Call everything from one context (the main loop), `rig_tick` about
 * every millisecond. Angles are millidegrees; the axes are 0 light theta, 1 light phi, 2 camera theta, 3 camera phi.
 */
#ifndef KINRAN_RIG_H
#define KINRAN_RIG_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#define RIG_REPORT 64u  /* bytes of a report, its id included */
#define RIG_PAYLOAD 48u /* bytes of its payload */
#define RIG_AXES 4u
#define RIG_NO_AXIS 0xFFu
#define RIG_X_SYNC 1u /* bit of the capabilities: `x_sync` counts the camera's exposures */

/* Geometry of the arms, as the host has it (workflow/kinran/rig/motion.py): change both. */
#define RIG_CLEARANCE_MDEG 8000.0 /* least angle between light arm and camera arm */
#define RIG_ON_NORMAL_MDEG 1000.0 /* camera theta under which the camera rests on N, out of the light arm's reach */
#define RIG_SWEPT_MDEG 1000.0     /* step in which a path is looked at */

#define RIG_STALL_MDEG 1000 /* distance between encoder and set point at which an axis counts as blocked */
#define RIG_WARM_UP_MS 1800000u

/* The report descriptor, for the USB stack: usage page 0xFF4B, usage 1, reports of 63 bytes and their id. */
#define RIG_DESCRIPTOR                                                                                                 \
    0x06, 0x4B, 0xFF, 0x09, 0x01, 0xA1, 0x01, 0x15, 0x00, 0x26, 0xFF, 0x00, 0x75, 0x08, 0x95, 0x3F, /* 63 bytes */     \
        0x85, 0x01, 0x09, 0x01, 0x91, 0x02,                                                         /* COMMAND */      \
        0x85, 0x0F, 0x09, 0x0F, 0x91, 0x02,                                                         /* ESTOP */        \
        0x85, 0x02, 0x09, 0x02, 0x81, 0x02,                                                         /* REPLY */        \
        0x85, 0x03, 0x09, 0x03, 0x81, 0x02,                                                         /* EVENT */        \
        0x85, 0x04, 0x09, 0x04, 0xB1, 0x02,                                                         /* IDENT */        \
        0x85, 0x05, 0x09, 0x05, 0xB1, 0x02,                                                         /* CONFIG */       \
        0x85, 0x06, 0x09, 0x06, 0xB1, 0x02,                                                         /* STATUS */       \
        0xC0

enum rig_report_id {
    RIG_COMMAND = 0x01,
    RIG_REPLY = 0x02,
    RIG_EVENT = 0x03,
    RIG_IDENT = 0x04,
    RIG_CONFIG = 0x05,
    RIG_STATUS = 0x06,
    RIG_ESTOP = 0x0F
};

enum rig_fault {
    RIG_FAULT_NONE,
    RIG_FAULT_ESTOP,
    RIG_FAULT_LIMIT_SWITCH,
    RIG_FAULT_STALL,
    RIG_FAULT_LAMP_OUT,
    RIG_FAULT_WATCHDOG,
    RIG_FAULT_SHUTTER,
    RIG_FAULT_OVERHEATED,
    RIG_FAULT_INTERLOCK,
    RIG_FAULT_XSYNC_MISSING,
    RIG_FAULT_COLLISION
};

/* The CONFIG feature. */
struct rig_config {
    int32_t low[RIG_AXES], high[RIG_AXES]; /* soft limits */
    uint16_t speed[RIG_AXES];              /* top speeds in 10 mdeg/s */
    uint8_t acceleration[RIG_AXES];        /* in deg/s^2 */
    uint16_t watchdog_ms;                  /* watchdog at start; 0: off */
    uint16_t homing_s;                     /* longest time of homing */
};

/* What the maker of a rig says of it. */
struct rig_maker {
    char serial[17];
    uint16_t firmware; /* the maker's own version */
    uint16_t capabilities;
    struct rig_config config; /* the machine's own: no host can widen it */
};

/* The hardware. `context` is handed to each function. */
struct rig_hardware {
    void *context;
    uint32_t (*random)(void *context); /* for the boot id: from a ring oscillator or the like, never a constant */

    void (*drive)(void *context, unsigned axis, int32_t mdeg);    /* be there now: a new set point each tick */
    int32_t (*position)(void *context, unsigned axis);            /* what the encoder says, or the steps made */
    void (*seek)(void *context, unsigned axis);                   /* begin to look for the reference */
    bool (*found)(void *context, unsigned axis);                  /* it is found, and `position` counts from it */
    void (*halt)(void *context);                                  /* stop all motors, and any search */
    bool (*at_limit)(void *context, unsigned axis);               /* a limit switch is pressed */
    bool (*door_open)(void *context);                             /* interlock */
    void (*lamp)(void *context, bool on);
    void (*shutter)(void *context, bool open);
    uint32_t (*photodiode)(void *context);                        /* counts now */
    void (*release)(void *context, uint32_t open_us);             /* hold the camera's release line for so long; 0: let go */
    uint32_t (*x_sync)(void *context);                            /* edges counted, ever rising */
    void (*send)(void *context, const uint8_t report[RIG_REPORT]); /* queue an input report; never wait */
    void (*keep)(void *context, const uint8_t config[RIG_PAYLOAD]); /* store CONFIG for the next start */
};

/* Light over a window of time. */
struct rig_window {
    uint64_t sum;
    uint32_t count;
};

/* A trapezoid from rest to rest, for all axes at once: that of the axis that takes longest. */
struct rig_path {
    double start[RIG_AXES], end[RIG_AXES];
    double distance, speed, acceleration; /* of the axis that sets the pace */
    double seconds;
};

/* State of the firmware; read it as you like, and change only `lamp_temperature` and `lamp_hours`. */
struct rig {
    const struct rig_hardware *hw;
    const struct rig_maker *maker;
    struct rig_config config;
    uint32_t boot;
    uint8_t reset_cause;
    uint32_t now, booted;

    uint16_t last_seq;
    uint8_t last_command[RIG_REPORT], last_reply[RIG_REPORT];

    uint8_t homed, moving, sought;
    uint8_t job, opcode, job_state;
    uint32_t job_started;
    double job_ms;
    struct rig_path path;
    int32_t following_error;

    uint8_t batch, fired, batch_count;
    uint16_t gap_ms;
    uint32_t open_us[8], edges, edges_at_start;
    double judge_ms;

    uint16_t fault;
    uint8_t fault_axis;
    bool door;

    bool lamp;
    uint32_t lit;
    uint16_t lamp_temperature, lamp_hours;
    bool shutter;
    uint32_t opened, longest_ms;
    uint32_t photodiode;
    struct rig_window open_window, intensity_window;

    uint32_t fed, watchdog_ms;
    uint32_t events, event_at, event_ms;
};

/* Start: a new boot id, pose unknown, lamp off, shutter closed. `kept` is what `keep` stored last, or NULL. */
void rig_init(struct rig *rig, const struct rig_hardware *hw, const struct rig_maker *maker,
              const uint8_t kept[RIG_PAYLOAD], uint8_t reset_cause, uint32_t now_ms);

/* Handle an output report, its id first. */
void rig_output(struct rig *rig, const uint8_t *data, size_t length);

/* Fill in a feature report, its id first; false where there is none of this number: stall the request. */
bool rig_get_feature(const struct rig *rig, uint8_t id, uint8_t report[RIG_REPORT]);

/* Take a feature report, its id first; false where it is refused: stall the request. */
bool rig_set_feature(struct rig *rig, const uint8_t *data, size_t length);

/* Let time pass; `now_ms` may wrap around. */
void rig_tick(struct rig *rig, uint32_t now_ms);

/* Latch a fault that only the hardware sees, such as RIG_FAULT_LAMP_OUT: motion stops, the shutter closes. */
void rig_trip(struct rig *rig, enum rig_fault fault, uint8_t axis);

/* CRC-32 as zlib's. */
uint32_t rig_crc(const uint8_t *data, size_t length);

#endif
