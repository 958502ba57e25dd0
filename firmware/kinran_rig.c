#include "kinran_rig.h"

#include <math.h>
#include <string.h>

#define VERSION 1u
#define MINOR 1u
#define HEADER 12u
#define CRC_AT 60u
#define VALIDATE_ONLY 1u
#define ALL_AXES 0x0Fu
#define MOVING_EVENT_MS 100u
#define IDLE_EVENT_MS 1000u
#define MOVE_LENGTH 36u
#define EXPOSE_LENGTH 36u
#define CONFIG_1_0_LENGTH 46u /* protocol 1.0 had no homing time */

enum status {
    OK,
    ACCEPTED,
    BUSY,
    BAD_CRC,
    BAD_ARG,
    LIMIT,
    NOT_HOMED,
    FAULTED,
    INTERLOCK,
    STALE_BOOT,
    UNSUPPORTED,
    BAD_SEQ,
    COLLISION
};

enum opcode {
    NOP = 0x00,
    HELLO = 0x01,
    HOME = 0x10,
    MOVE = 0x11,
    STOP = 0x12,
    CLEAR = 0x13,
    LAMP = 0x20,
    SHUTTER = 0x21,
    INTENSITY = 0x22,
    EXPOSE = 0x30,
    WATCHDOG = 0x40
};

enum job_state { JOB_IDLE, JOB_RUNNING, JOB_DONE, JOB_STOPPED, JOB_FAULTED };

/* Bits of the status flags. */
enum flag { HOMED = 0, MOVING = 4, OPEN = 8, LIT = 9, WATCHED = 10, FAULT = 11, DOOR = 12, WARM = 13 };

/* A command as it was received. */
struct command {
    uint16_t seq;
    uint8_t opcode, flags, length;
    uint32_t boot;
    const uint8_t *payload;
};

/* -- bytes -------------------------------------------------------------------------------------------------------- */

static uint16_t get16(const uint8_t *at) {
    return (uint16_t)(at[0] | at[1] << 8);
}

static uint32_t get32(const uint8_t *at) {
    return (uint32_t)get16(at) | (uint32_t)get16(at + 2) << 16;
}

static int32_t get_i32(const uint8_t *at) {
    uint32_t bits = get32(at);
    int32_t value;
    memcpy(&value, &bits, sizeof value);
    return value;
}

static uint8_t *put8(uint8_t *at, unsigned value) {
    at[0] = (uint8_t)value;
    return at + 1;
}

static uint8_t *put16(uint8_t *at, unsigned value) {
    return put8(put8(at, value & 0xFFu), value >> 8 & 0xFFu);
}

static uint8_t *put32(uint8_t *at, uint32_t value) {
    return put16(put16(at, value & 0xFFFFu), value >> 16);
}

/* Whether an axis is in a mask. */
static bool has(uint8_t mask, unsigned axis) {
    return (mask & 1u << axis) != 0;
}

uint32_t rig_crc(const uint8_t *data, size_t length) {
    uint32_t crc = 0xFFFFFFFFu;
    for (size_t i = 0; i < length; i++) {
        crc ^= data[i];
        for (int bit = 0; bit < 8; bit++)
            crc = crc >> 1 ^ (crc & 1u ? 0xEDB88320u : 0u);
    }
    return ~crc;
}

/* Whether bytes are a report of this protocol. */
static bool sound(const uint8_t *data, size_t length) {
    return length == RIG_REPORT && rig_crc(data, CRC_AT) == get32(data + CRC_AT) && data[1] == VERSION &&
           data[6] <= RIG_PAYLOAD;
}

/* Put header and CRC around the payload that `report` holds already. */
static void finish_report(const struct rig *rig, uint8_t report[RIG_REPORT], unsigned id, uint16_t seq, unsigned opcode,
                          unsigned code, unsigned length) {
    uint8_t *at = put16(put8(put8(report, id), VERSION), seq);
    put32(put8(put8(put8(put8(at, opcode), code), length), rig->job), rig->boot);
    memset(report + HEADER + length, 0, RIG_PAYLOAD - length);
    put32(report + CRC_AT, rig_crc(report, CRC_AT));
}

static uint16_t flags_of(const struct rig *rig) {
    bool warm = rig->lamp && rig->now - rig->lit >= RIG_WARM_UP_MS;
    return (uint16_t)(rig->homed << HOMED | rig->moving << MOVING | rig->shutter << OPEN | rig->lamp << LIT |
                      (rig->watchdog_ms > 0) << WATCHED | (rig->fault != RIG_FAULT_NONE) << FAULT | rig->door << DOOR |
                      warm << WARM);
}

static void put_status(const struct rig *rig, uint8_t *at) {
    at = put32(at, rig->now - rig->booted);
    for (unsigned i = 0; i < RIG_AXES; i++)
        at = put32(at, has(rig->homed, i) ? (uint32_t)rig->hw->position(rig->hw->context, i) : 0u);
    at = put16(put16(at, flags_of(rig)), rig->fault);
    at = put8(put8(put8(put8(at, rig->fault_axis), rig->job), rig->job_state), rig->batch);
    at = put32(put32(at, rig->hw->x_sync(rig->hw->context) - rig->edges_at_start), rig->photodiode);
    at = put16(put16(at, rig->lamp_temperature), rig->lamp_hours);
    put32(put32(at, rig->events), (uint32_t)rig->following_error);
}

static void put_config(const struct rig_config *config, uint8_t *at) {
    for (unsigned i = 0; i < RIG_AXES; i++)
        at = put32(put32(at, (uint32_t)config->low[i]), (uint32_t)config->high[i]);
    for (unsigned i = 0; i < RIG_AXES; i++)
        at = put16(at, config->speed[i]);
    for (unsigned i = 0; i < RIG_AXES; i++)
        at = put8(at, config->acceleration[i]);
    put16(put16(at, config->watchdog_ms), config->homing_s);
}

static void get_config(const uint8_t *at, struct rig_config *config) {
    for (unsigned i = 0; i < RIG_AXES; i++) {
        config->low[i] = get_i32(at + 8 * i);
        config->high[i] = get_i32(at + 8 * i + 4);
        config->speed[i] = get16(at + 32 + 2 * i);
        config->acceleration[i] = at[40 + i];
    }
    config->watchdog_ms = get16(at + 44);
    config->homing_s = get16(at + 46);
}

/* Whether a machine whose own configuration is `own` can be configured like this. */
static bool within(const struct rig_config *config, const struct rig_config *own) {
    for (unsigned i = 0; i < RIG_AXES; i++)
        if (config->low[i] < own->low[i] || config->low[i] > config->high[i] || config->high[i] > own->high[i] ||
            config->speed[i] > own->speed[i] || config->acceleration[i] > own->acceleration[i])
            return false;
    return true;
}

/* -- events and faults -------------------------------------------------------------------------------------------- */

static void send_event(struct rig *rig) {
    uint8_t report[RIG_REPORT];
    rig->events++;
    rig->event_at = rig->now;
    rig->event_ms = rig->job_state == JOB_RUNNING ? MOVING_EVENT_MS : IDLE_EVENT_MS;
    put_status(rig, report + HEADER);
    finish_report(rig, report, RIG_EVENT, 0, 0, 0, RIG_PAYLOAD);
    rig->hw->send(rig->hw->context, report);
}

static void look_at(struct rig *rig, struct rig_window *window) {
    window->sum += rig->hw->photodiode(rig->hw->context);
    window->count++;
}

static void open_window(struct rig *rig, struct rig_window *window) {
    window->sum = window->count = 0;
    look_at(rig, window);
}

static uint32_t mean(const struct rig_window *window) {
    return (uint32_t)(window->sum / window->count);
}

static void close_shutter(struct rig *rig) {
    if (rig->shutter)
        rig->photodiode = mean(&rig->open_window);
    rig->shutter = false;
    rig->hw->shutter(rig->hw->context, false);
}

static void set_lamp(struct rig *rig, bool on) {
    if (on && !rig->lamp)
        rig->lit = rig->now;
    rig->lamp = on;
    rig->hw->lamp(rig->hw->context, on);
}

/* End a running job where it is. */
static void end_job(struct rig *rig, enum job_state state) {
    rig->hw->halt(rig->hw->context);
    rig->hw->release(rig->hw->context, 0);
    if (rig->job_state == JOB_RUNNING)
        rig->job_state = (uint8_t)state;
    rig->moving = 0;
}

void rig_trip(struct rig *rig, enum rig_fault fault, uint8_t axis) {
    end_job(rig, JOB_FAULTED);
    rig->fault = (uint16_t)fault;
    rig->fault_axis = axis;
    close_shutter(rig);
    if (fault == RIG_FAULT_LAMP_OUT)
        set_lamp(rig, false);
    send_event(rig);
}

/* -- motion ------------------------------------------------------------------------------------------------------- */

/* Seconds of one axis from rest to rest. */
static double travel_time(double distance, double speed, double acceleration) {
    if (distance <= speed * speed / acceleration)
        return 2 * sqrt(distance / acceleration);
    return distance / speed + speed / acceleration;
}

/* Share of a path that is covered after some seconds. */
static double travelled(const struct rig_path *path, double seconds) {
    double total = path->seconds, left = total - seconds;
    double ramp = fmin(total / 2, path->speed / path->acceleration);
    if (left <= 0)
        return 1;
    if (seconds < ramp)
        return path->acceleration * seconds * seconds / 2 / path->distance;
    if (left < ramp)
        return 1 - path->acceleration * left * left / 2 / path->distance;
    return (path->acceleration * ramp * ramp / 2 + path->speed * (seconds - ramp)) / path->distance;
}

/* Whether the arms are too close: by the angle between them on the sphere. */
static bool arms_meet(const double pose[RIG_AXES]) {
    const double radian = 3.14159265358979323846 / 180000;
    if (fabs(pose[2]) < RIG_ON_NORMAL_MDEG)
        return false;
    double light = pose[0] * radian, camera = pose[2] * radian;
    double cosine = cos(light) * cos(camera) + sin(light) * sin(camera) * cos((pose[1] - pose[3]) * radian);
    return cosine > cos(RIG_CLEARANCE_MDEG * radian);
}

/* Whether the arms meet on the way; as all axes start and arrive at once, it is straight in the four angles. */
static bool collides(const struct rig_path *path) {
    double longest = 0, pose[RIG_AXES];
    for (unsigned i = 0; i < RIG_AXES; i++)
        longest = fmax(longest, fabs(path->end[i] - path->start[i]));
    unsigned steps = (unsigned)fmax(1, ceil(longest / RIG_SWEPT_MDEG));
    for (unsigned k = 0; k <= steps; k++) {
        for (unsigned i = 0; i < RIG_AXES; i++)
            pose[i] = path->start[i] + (path->end[i] - path->start[i]) * k / steps;
        if (arms_meet(pose))
            return true;
    }
    return false;
}

/* Let the slowest axis set the pace; `speeds` are the payload of MOVE, in mdeg/s, 0 for top speed. */
static void set_pace(const struct rig *rig, struct rig_path *path, const uint8_t *speeds) {
    const struct rig_config *own = &rig->maker->config;
    path->seconds = 0;
    for (unsigned i = 0; i < RIG_AXES; i++) {
        double distance = fabs(path->end[i] - path->start[i]);
        double speed = 10.0 * (rig->config.speed[i] ? rig->config.speed[i] : own->speed[i]);
        double acceleration = 1000.0 * (rig->config.acceleration[i] ? rig->config.acceleration[i] : own->acceleration[i]);
        uint32_t wanted = get32(speeds + 4 * i);
        speed = wanted ? fmin(speed, wanted) : speed;
        double seconds = travel_time(distance, speed, acceleration);
        if (seconds > path->seconds) {
            path->seconds = seconds;
            path->distance = distance;
            path->speed = speed;
            path->acceleration = acceleration;
        }
    }
}

/* -- jobs --------------------------------------------------------------------------------------------------------- */

static enum status begin_job(struct rig *rig, enum opcode opcode, double ms) {
    rig->job = (uint8_t)(rig->job % 255 + 1);
    rig->opcode = (uint8_t)opcode;
    rig->job_state = JOB_RUNNING;
    rig->job_started = rig->now;
    rig->job_ms = ms;
    rig->event_at = rig->now;
    rig->event_ms = MOVING_EVENT_MS;
    return ACCEPTED;
}

static void finish_job(struct rig *rig) {
    rig->job_state = JOB_DONE;
    rig->moving = 0;
    send_event(rig);
}

static void fire(struct rig *rig) {
    uint32_t open_us = rig->open_us[rig->fired++];
    rig->edges = rig->hw->x_sync(rig->hw->context);
    rig->judge_ms += open_us / 1000.0 + rig->gap_ms;
    rig->hw->release(rig->hw->context, open_us);
}

/* When open time and gap of an exposure are over, its X-sync edge must have come. */
static void go_on_exposing(struct rig *rig, double ms) {
    while (rig->job_state == JOB_RUNNING && ms >= rig->judge_ms) {
        bool counts = rig->maker->capabilities & RIG_X_SYNC;
        if (counts && rig->hw->x_sync(rig->hw->context) == rig->edges) {
            rig_trip(rig, RIG_FAULT_XSYNC_MISSING, RIG_NO_AXIS);
            return;
        }
        rig->batch++;
        if (rig->fired == rig->batch_count)
            finish_job(rig);
        else
            fire(rig);
    }
}

static void go_on_homing(struct rig *rig, double ms) {
    for (unsigned i = 0; i < RIG_AXES; i++)
        if (has(rig->moving, i) && rig->hw->found(rig->hw->context, i))
            rig->moving &= (uint8_t)~(1u << i);
    if (!rig->moving) {
        rig->homed |= rig->sought;
        finish_job(rig);
    } else if (rig->config.homing_s && ms > 1200.0 * rig->config.homing_s) {
        uint8_t axis = 0;
        while (!has(rig->moving, axis))
            axis++;
        rig_trip(rig, RIG_FAULT_STALL, axis);
    }
}

static void go_on_moving(struct rig *rig, double ms) {
    double share = travelled(&rig->path, ms / 1000);
    for (unsigned i = 0; i < RIG_AXES; i++) {
        if (!has(rig->moving, i))
            continue;
        if (rig->hw->at_limit(rig->hw->context, i)) {
            rig_trip(rig, RIG_FAULT_LIMIT_SWITCH, (uint8_t)i);
            return;
        }
        int32_t set = (int32_t)lround(rig->path.start[i] + (rig->path.end[i] - rig->path.start[i]) * share);
        rig->hw->drive(rig->hw->context, i, set);
        int32_t error = rig->hw->position(rig->hw->context, i) - set;
        error = error < 0 ? -error : error;
        if (error > rig->following_error)
            rig->following_error = error;
        if (error > RIG_STALL_MDEG) {
            rig_trip(rig, RIG_FAULT_STALL, (uint8_t)i);
            return;
        }
    }
    if (ms >= rig->job_ms)
        finish_job(rig);
}

static void go_on(struct rig *rig) {
    double ms = rig->now - rig->job_started;
    switch (rig->opcode) {
    case HOME:
        go_on_homing(rig, ms);
        break;
    case MOVE:
        go_on_moving(rig, ms);
        break;
    case EXPOSE:
        go_on_exposing(rig, ms);
        break;
    default:
        look_at(rig, &rig->intensity_window);
        if (ms >= rig->job_ms) {
            rig->photodiode = mean(&rig->intensity_window);
            finish_job(rig);
        }
    }
}

/* -- commands: each is checked first; what is only validated goes no further ---------------------------------------- */

static enum status home(struct rig *rig, const struct command *command, bool act) {
    if (command->length != 1 || !command->payload[0] || command->payload[0] & ~ALL_AXES)
        return BAD_ARG;
    if (!act)
        return OK;
    rig->sought = rig->moving = command->payload[0];
    rig->homed &= (uint8_t)~rig->sought;
    rig->following_error = 0;
    for (unsigned i = 0; i < RIG_AXES; i++)
        if (has(rig->sought, i))
            rig->hw->seek(rig->hw->context, i);
    return begin_job(rig, HOME, 0);
}

static enum status move(struct rig *rig, const struct command *command, bool act) {
    const uint8_t *payload = command->payload;
    if (command->length != MOVE_LENGTH || payload[0] & ~ALL_AXES)
        return BAD_ARG;
    if (rig->homed != ALL_AXES)
        return NOT_HOMED; /* where an arm stands that is not moved must be known, too */
    struct rig_path path = {0};
    unsigned moving = 0;
    for (unsigned i = 0; i < RIG_AXES; i++) {
        int32_t at = rig->hw->position(rig->hw->context, i);
        path.start[i] = path.end[i] = at;
        if (!has(payload[0], i))
            continue;
        int32_t target = get_i32(payload + 4 + 4 * i);
        if (target < rig->config.low[i] || target > rig->config.high[i])
            return LIMIT;
        path.end[i] = target;
        moving |= (unsigned)(target != at) << i;
    }
    if (collides(&path))
        return COLLISION;
    if (!act)
        return OK;
    set_pace(rig, &path, payload + 20);
    rig->path = path;
    rig->moving = (uint8_t)moving;
    rig->following_error = 0;
    return begin_job(rig, MOVE, 1000 * path.seconds + get16(payload + 2));
}

static enum status open_shutter(struct rig *rig, const struct command *command, bool act) {
    if (command->length != 5 || !get32(command->payload + 1))
        return BAD_ARG;
    if (!act)
        return OK;
    if (!rig->shutter)
        open_window(rig, &rig->open_window);
    rig->shutter = true;
    rig->opened = rig->now;
    rig->longest_ms = get32(command->payload + 1);
    rig->hw->shutter(rig->hw->context, true);
    return OK;
}

static enum status switch_lamp(struct rig *rig, const struct command *command, bool act) {
    if (command->length != 1)
        return BAD_ARG;
    if (act)
        set_lamp(rig, command->payload[0]);
    return OK;
}

static enum status measure(struct rig *rig, const struct command *command, bool act) {
    if (command->length != 2)
        return BAD_ARG;
    if (!act)
        return OK;
    open_window(rig, &rig->intensity_window);
    return begin_job(rig, INTENSITY, get16(command->payload));
}

static enum status expose(struct rig *rig, const struct command *command, bool act) {
    const uint8_t *payload = command->payload;
    if (command->length != EXPOSE_LENGTH || payload[0] < 1 || payload[0] > 8)
        return BAD_ARG;
    if (!act)
        return OK;
    rig->batch = rig->fired = 0;
    rig->batch_count = payload[0];
    rig->gap_ms = get16(payload + 2);
    for (unsigned k = 0; k < rig->batch_count; k++)
        rig->open_us[k] = get32(payload + 4 + 4 * k);
    rig->judge_ms = 0;
    enum status status = begin_job(rig, EXPOSE, 0);
    fire(rig);
    return status;
}

static enum status clear(struct rig *rig, const struct command *command, bool act) {
    if (command->length != 2)
        return BAD_ARG;
    uint16_t seen = get16(command->payload);
    if (seen != rig->fault || (seen == RIG_FAULT_INTERLOCK && rig->door))
        return BAD_ARG;
    if (act && seen) {
        rig->fault = RIG_FAULT_NONE;
        rig->fault_axis = RIG_NO_AXIS;
        rig->job_state = JOB_IDLE;
    }
    return OK;
}

static enum status execute(struct rig *rig, const struct command *command) {
    bool act = !(command->flags & VALIDATE_ONLY);
    if (command->opcode == NOP || command->opcode == HELLO)
        return OK;
    if (command->boot != rig->boot)
        return STALE_BOOT;
    switch (command->opcode) { /* what makes things quieter is heard always */
    case STOP:
        if (act)
            end_job(rig, JOB_STOPPED);
        return OK;
    case CLEAR:
        return clear(rig, command, act);
    case WATCHDOG:
        if (command->length != 4)
            return BAD_ARG;
        if (act)
            rig->watchdog_ms = get32(command->payload);
        return OK;
    case SHUTTER:
        if (command->length && !command->payload[0]) {
            if (act)
                close_shutter(rig);
            return OK;
        }
        break;
    default:
        break;
    }
    if (rig->door)
        return INTERLOCK;
    if (rig->fault)
        return FAULTED;
    if (rig->job_state == JOB_RUNNING)
        return BUSY;
    switch (command->opcode) {
    case HOME:
        return home(rig, command, act);
    case MOVE:
        return move(rig, command, act);
    case LAMP:
        return switch_lamp(rig, command, act);
    case SHUTTER:
        return open_shutter(rig, command, act);
    case INTENSITY:
        return measure(rig, command, act);
    case EXPOSE:
        return expose(rig, command, act);
    default:
        return UNSUPPORTED;
    }
}

/* Make a reply, with the status unless the command was not understood or not heard, and send it. */
static void reply(struct rig *rig, uint8_t report[RIG_REPORT], const struct command *command, enum status status) {
    unsigned length = status == BAD_CRC || status == BAD_SEQ ? 0 : RIG_PAYLOAD;
    if (length)
        put_status(rig, report + HEADER);
    finish_report(rig, report, RIG_REPLY, command->seq, command->opcode, status, length);
    rig->hw->send(rig->hw->context, report);
}

/* -- what the USB stack and the main loop call ---------------------------------------------------------------------- */

void rig_init(struct rig *rig, const struct rig_hardware *hw, const struct rig_maker *maker,
              const uint8_t kept[RIG_PAYLOAD], uint8_t reset_cause, uint32_t now_ms) {
    memset(rig, 0, sizeof *rig);
    rig->hw = hw;
    rig->maker = maker;
    rig->config = maker->config;
    if (kept) {
        struct rig_config config;
        get_config(kept, &config);
        if (within(&config, &maker->config))
            rig->config = config;
    }
    do
        rig->boot = hw->random(hw->context);
    while (!rig->boot);
    rig->reset_cause = reset_cause;
    rig->now = rig->booted = rig->fed = rig->event_at = now_ms;
    rig->event_ms = IDLE_EVENT_MS;
    rig->watchdog_ms = rig->config.watchdog_ms;
    rig->edges_at_start = hw->x_sync(hw->context);
    hw->halt(hw->context);
    hw->release(hw->context, 0);
    hw->lamp(hw->context, false);
    hw->shutter(hw->context, false);
    rig->fault_axis = RIG_NO_AXIS; /* an open door is a fault at the first tick */
}

void rig_output(struct rig *rig, const uint8_t *data, size_t length) {
    uint8_t report[RIG_REPORT];
    struct command command = {0};
    if (!length)
        return;
    if (data[0] == RIG_ESTOP) {
        rig_trip(rig, RIG_FAULT_ESTOP, RIG_NO_AXIS);
        return;
    }
    if (data[0] != RIG_COMMAND)
        return;
    if (!sound(data, length)) {
        reply(rig, report, &command, BAD_CRC);
        return;
    }
    rig->fed = rig->now;
    command.seq = get16(data + 2);
    command.opcode = data[4];
    command.flags = data[5];
    command.length = data[6];
    command.boot = get32(data + 8);
    command.payload = data + HEADER;
    if (command.opcode != HELLO && (command.seq == 0 || command.seq == rig->last_seq)) {
        if (memcmp(data, rig->last_command, RIG_REPORT) == 0)
            rig->hw->send(rig->hw->context, rig->last_reply);
        else
            reply(rig, report, &command, BAD_SEQ);
        return;
    }
    enum status status = execute(rig, &command);
    rig->last_seq = command.seq;
    memcpy(rig->last_command, data, RIG_REPORT);
    reply(rig, rig->last_reply, &command, status);
}

bool rig_get_feature(const struct rig *rig, uint8_t id, uint8_t report[RIG_REPORT]) {
    uint8_t *at = report + HEADER;
    unsigned length = RIG_PAYLOAD;
    switch (id) {
    case RIG_STATUS:
        put_status(rig, at);
        break;
    case RIG_CONFIG:
        put_config(&rig->config, at);
        break;
    case RIG_IDENT:
        at = put16(put16(put16(put16(at, VERSION), MINOR), rig->maker->firmware), rig->maker->capabilities);
        memcpy(at, rig->maker->serial, 16);
        at[16] = rig->reset_cause;
        length = 25;
        break;
    default:
        return false;
    }
    finish_report(rig, report, id, 0, 0, 0, length);
    return true;
}

bool rig_set_feature(struct rig *rig, const uint8_t *data, size_t length) {
    struct rig_config config;
    uint8_t kept[RIG_PAYLOAD];
    if (!sound(data, length) || data[0] != RIG_CONFIG || rig->job_state == JOB_RUNNING)
        return false;
    if (data[6] != RIG_PAYLOAD && data[6] != CONFIG_1_0_LENGTH)
        return false;
    get_config(data + HEADER, &config);
    if (data[6] == CONFIG_1_0_LENGTH)
        config.homing_s = 0;
    if (!within(&config, &rig->maker->config))
        return false;
    rig->config = config;
    put_config(&config, kept);
    rig->hw->keep(rig->hw->context, kept);
    return true;
}

void rig_tick(struct rig *rig, uint32_t now_ms) {
    rig->now = now_ms;
    bool door = rig->hw->door_open(rig->hw->context), opened = door && !rig->door;
    rig->door = door;
    if (opened)
        rig_trip(rig, RIG_FAULT_INTERLOCK, RIG_NO_AXIS);
    if (rig->job_state == JOB_RUNNING)
        go_on(rig);
    if (rig->shutter) {
        look_at(rig, &rig->open_window);
        if (now_ms - rig->opened >= rig->longest_ms)
            close_shutter(rig);
    }
    bool busy = rig->job_state == JOB_RUNNING || rig->shutter;
    if (busy && rig->watchdog_ms && now_ms - rig->fed >= rig->watchdog_ms)
        rig_trip(rig, RIG_FAULT_WATCHDOG, RIG_NO_AXIS);
    if (now_ms - rig->event_at >= rig->event_ms)
        send_event(rig);
}
