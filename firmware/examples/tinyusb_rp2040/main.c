/* A goniometer on a Raspberry Pi Pico: four stepper drivers with STEP and DIR inputs, home switches, a lamp relay, a
 * shutter, a photodiode, a camera, a door. Change the tables at the top to your machine.
 *
 * The main loop calls USB and the core once a millisecond. The core says where each axis should be; a timer interrupt of
 * 50 kHz makes the steps to there, evenly over the millisecond.
 */
#include <string.h>

#include "hardware/adc.h"
#include "hardware/flash.h"
#include "hardware/gpio.h"
#include "hardware/sync.h"
#include "hardware/watchdog.h"
#include "kinran_rig.h"
#include "pico/rand.h"
#include "pico/stdlib.h"
#include "pico/unique_id.h"
#include "tusb.h"

/* -- the machine -------------------------------------------------------------------------------------------------- */

struct motor {
    unsigned step, dir, home;   /* pins; the home switch pulls its pin down */
    int32_t steps_per_turn;     /* microsteps of the motor, times its gear */
    int32_t home_mdeg;          /* where the home switch lets go */
    int32_t seek_mdeg_per_ms;   /* speed of homing */
};

/* 200 steps, 16 microsteps; worm gears 1:50 for theta, belts 1:18 for phi. */
static const struct motor MOTORS[RIG_AXES] = {
    {.step = 2, .dir = 3, .home = 10, .steps_per_turn = 160000, .home_mdeg = -2000, .seek_mdeg_per_ms = 5},
    {.step = 4, .dir = 5, .home = 11, .steps_per_turn = 57600, .home_mdeg = -12000, .seek_mdeg_per_ms = 10},
    {.step = 6, .dir = 7, .home = 12, .steps_per_turn = 160000, .home_mdeg = -77000, .seek_mdeg_per_ms = 5},
    {.step = 8, .dir = 9, .home = 13, .steps_per_turn = 57600, .home_mdeg = -362000, .seek_mdeg_per_ms = 10},
};

enum pin { ENABLE = 14, DOOR = 15, LAMP = 16, SHUTTER = 17, RELEASE = 18, X_SYNC = 19, PHOTODIODE = 26 };

static struct rig_maker maker = {
    .firmware = 1,
    .capabilities = RIG_X_SYNC,
    .config =
        {
            .low = {0, -10000, -75000, -360000},
            .high = {90000, 370000, 75000, 360000},
            .speed = {1000, 3000, 1000, 3000},
            .acceleration = {20, 60, 20, 60},
            .watchdog_ms = 2000,
            .homing_s = 90,
        },
};

#define STEPS_PER_MS 50u                                       /* most steps of an axis in a millisecond */
#define KEPT_AT (PICO_FLASH_SIZE_BYTES - FLASH_SECTOR_SIZE)    /* the last sector of the flash keeps CONFIG */
#define KEPT_MARK 0x4B494E31u                                  /* "KIN1": something is kept */
#define HANG_MS 500                                            /* a loop that hangs for so long restarts the chip */
#define QUEUE 64u                                              /* reports that wait for the host, as in hidraw */

static struct rig rig;

/* -- steps: the interrupt follows the set points ------------------------------------------------------------------- */

static volatile int32_t wanted[RIG_AXES], made[RIG_AXES]; /* steps */
static volatile uint32_t pace[RIG_AXES];                  /* share of the interrupts that make a step, of 2^32 */

static int32_t to_steps(unsigned axis, int32_t mdeg) {
    return (int32_t)((int64_t)mdeg * MOTORS[axis].steps_per_turn / 360000);
}

static int32_t to_mdeg(unsigned axis, int32_t steps) {
    return (int32_t)((int64_t)steps * 360000 / MOTORS[axis].steps_per_turn);
}

/* Every 20 us. A pulse lasts until the next interrupt, more than any common driver asks for. */
static bool make_steps(repeating_timer_t *timer) {
    static uint32_t phase[RIG_AXES];
    (void)timer;
    for (unsigned i = 0; i < RIG_AXES; i++) {
        gpio_put(MOTORS[i].step, false);
        uint32_t before = phase[i];
        phase[i] += pace[i];
        if (wanted[i] == made[i] || phase[i] >= before)
            continue;
        bool forward = wanted[i] > made[i];
        gpio_put(MOTORS[i].dir, forward);
        gpio_put(MOTORS[i].step, true);
        made[i] += forward ? 1 : -1;
    }
    return true;
}

static void go_to(unsigned axis, int32_t steps) {
    uint32_t left = (uint32_t)(steps > made[axis] ? steps - made[axis] : made[axis] - steps);
    uint32_t share = left < STEPS_PER_MS ? (left + 1) * (UINT32_MAX / (STEPS_PER_MS + 1)) : UINT32_MAX;
    pace[axis] = share;
    wanted[axis] = steps;
}

/* -- homing: back to the switch, and forward until it lets go -------------------------------------------------------- */

enum phase { AT_REST, BACK, FORWARD };
static enum phase homing[RIG_AXES];
static int32_t seeking_mdeg[RIG_AXES];

static bool pressed(unsigned axis) {
    return !gpio_get(MOTORS[axis].home);
}

static void go_on_homing(void) {
    for (unsigned i = 0; i < RIG_AXES; i++) {
        if (homing[i] == BACK && pressed(i))
            homing[i] = FORWARD;
        if (homing[i] == FORWARD && !pressed(i)) {
            uint32_t interrupts = save_and_disable_interrupts();
            made[i] = wanted[i] = to_steps(i, MOTORS[i].home_mdeg);
            restore_interrupts(interrupts);
            homing[i] = AT_REST;
        }
        if (homing[i] == AT_REST)
            continue;
        seeking_mdeg[i] += homing[i] == BACK ? -MOTORS[i].seek_mdeg_per_ms : MOTORS[i].seek_mdeg_per_ms;
        go_to(i, to_steps(i, seeking_mdeg[i]));
    }
}

/* -- what the core asks for ---------------------------------------------------------------------------------------- */

static uint32_t random_number(void *context) {
    (void)context;
    return get_rand_32();
}

static void drive(void *context, unsigned axis, int32_t mdeg) {
    (void)context;
    go_to(axis, to_steps(axis, mdeg));
}

/* Steps made. With an encoder on the arm, return what it says: then a lost step is seen. */
static int32_t position(void *context, unsigned axis) {
    (void)context;
    return to_mdeg(axis, made[axis]);
}

static void seek(void *context, unsigned axis) {
    (void)context;
    seeking_mdeg[axis] = to_mdeg(axis, made[axis]);
    homing[axis] = BACK;
}

static bool found(void *context, unsigned axis) {
    (void)context;
    return homing[axis] == AT_REST;
}

static void halt(void *context) {
    (void)context;
    uint32_t interrupts = save_and_disable_interrupts();
    for (unsigned i = 0; i < RIG_AXES; i++) {
        homing[i] = AT_REST;
        wanted[i] = made[i];
    }
    restore_interrupts(interrupts);
}

static bool at_limit(void *context, unsigned axis) {
    (void)context;
    return pressed(axis);
}

static bool door_open(void *context) {
    (void)context;
    return gpio_get(DOOR);
}

static void lamp(void *context, bool on) {
    (void)context;
    gpio_put(LAMP, on);
}

static void shutter(void *context, bool open) {
    (void)context;
    gpio_put(SHUTTER, open);
}

static uint32_t photodiode(void *context) {
    (void)context;
    return adc_read();
}

static alarm_id_t letting_go = -1;

static int64_t let_go(alarm_id_t alarm, void *context) {
    (void)alarm;
    (void)context;
    gpio_put(RELEASE, false);
    return 0;
}

static void release(void *context, uint32_t open_us) {
    (void)context;
    if (letting_go > 0)
        cancel_alarm(letting_go);
    letting_go = -1;
    gpio_put(RELEASE, open_us > 0);
    if (open_us)
        letting_go = add_alarm_in_us(open_us, let_go, NULL, true);
}

static volatile uint32_t edges;

static void count_edge(unsigned pin, uint32_t events) {
    (void)pin;
    (void)events;
    edges++;
}

static uint32_t x_sync(void *context) {
    (void)context;
    return edges;
}

static uint8_t queue[QUEUE][RIG_REPORT];
static unsigned first, queued;

static void send(void *context, const uint8_t report[RIG_REPORT]) {
    (void)context;
    if (queued == QUEUE) { /* nobody reads: the oldest is lost */
        first = (first + 1) % QUEUE;
        queued--;
    }
    memcpy(queue[(first + queued++) % QUEUE], report, RIG_REPORT);
}

/* The core calls this at rest only: erasing the flash stops the chip for some 50 ms. */
static void keep(void *context, const uint8_t config[RIG_PAYLOAD]) {
    uint8_t page[FLASH_PAGE_SIZE] = {0};
    uint32_t mark = KEPT_MARK;
    (void)context;
    memcpy(page, &mark, sizeof mark);
    memcpy(page + sizeof mark, config, RIG_PAYLOAD);
    uint32_t interrupts = save_and_disable_interrupts();
    flash_range_erase(KEPT_AT, FLASH_SECTOR_SIZE);
    flash_range_program(KEPT_AT, page, sizeof page);
    restore_interrupts(interrupts);
}

static const uint8_t *kept(void) {
    const uint8_t *page = (const uint8_t *)(XIP_BASE + KEPT_AT);
    uint32_t mark;
    memcpy(&mark, page, sizeof mark);
    return mark == KEPT_MARK ? page + sizeof mark : NULL;
}

static const struct rig_hardware HARDWARE = {
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

/* -- what TinyUSB asks for ------------------------------------------------------------------------------------------- */

/* TinyUSB puts the id before the answer; an empty answer is a refusal, which the host takes for a damaged report. */
uint16_t tud_hid_get_report_cb(uint8_t instance, uint8_t id, hid_report_type_t type, uint8_t *buffer, uint16_t length) {
    uint8_t report[RIG_REPORT];
    (void)instance;
    if (type != HID_REPORT_TYPE_FEATURE || length < RIG_REPORT - 1 || !rig_get_feature(&rig, id, report))
        return 0;
    memcpy(buffer, report + 1, RIG_REPORT - 1);
    return RIG_REPORT - 1;
}

/* From the interrupt pipe `id` is 0 and the buffer begins with it; from the control pipe the id is given apart. */
void tud_hid_set_report_cb(uint8_t instance, uint8_t id, hid_report_type_t type, const uint8_t *buffer, uint16_t length) {
    uint8_t report[RIG_REPORT] = {0};
    size_t before = id ? 1 : 0;
    (void)instance;
    if (length + before > RIG_REPORT)
        return;
    report[0] = id;
    memcpy(report + before, buffer, length);
    if (type == HID_REPORT_TYPE_FEATURE)
        rig_set_feature(&rig, report, length + before);
    else
        rig_output(&rig, report, length + before);
}

/* -- start and loop -------------------------------------------------------------------------------------------------- */

static void set_up_pin(unsigned pin, bool output) {
    gpio_init(pin);
    gpio_set_dir(pin, output);
    if (!output)
        gpio_pull_up(pin);
}

static void set_up(void) {
    static repeating_timer_t timer;
    for (unsigned i = 0; i < RIG_AXES; i++) {
        set_up_pin(MOTORS[i].step, true);
        set_up_pin(MOTORS[i].dir, true);
        set_up_pin(MOTORS[i].home, false);
    }
    for (unsigned pin = LAMP; pin <= RELEASE; pin++)
        set_up_pin(pin, true);
    set_up_pin(ENABLE, true); /* low: the drivers are on */
    set_up_pin(DOOR, false);  /* the closed door pulls it down; a broken wire is an open door */
    set_up_pin(X_SYNC, false);
    gpio_set_irq_enabled_with_callback(X_SYNC, GPIO_IRQ_EDGE_FALL, true, count_edge);
    adc_init();
    adc_gpio_init(PHOTODIODE);
    adc_select_input(PHOTODIODE - 26);
    add_repeating_timer_us(-(int64_t)(1000 / STEPS_PER_MS), make_steps, NULL, &timer);
}

static void loop(void) {
    static uint32_t ticked;
    uint32_t now = to_ms_since_boot(get_absolute_time());
    tud_task();
    if (queued && tud_hid_ready() && tud_hid_report(queue[first][0], queue[first] + 1, RIG_REPORT - 1)) {
        first = (first + 1) % QUEUE;
        queued--;
    }
    if (now == ticked)
        return;
    ticked = now;
    go_on_homing();
    rig_tick(&rig, now);
    watchdog_update();
}

int main(void) {
    char serial[2 * PICO_UNIQUE_BOARD_ID_SIZE_BYTES + 1];
    uint8_t cause = watchdog_caused_reboot() ? 2 : 0;
    set_up();
    pico_get_unique_board_id_string(serial, sizeof serial);
    memcpy(maker.serial, serial, 16);
    rig_init(&rig, &HARDWARE, &maker, kept(), cause, to_ms_since_boot(get_absolute_time()));
    tusb_init();
    watchdog_enable(HANG_MS, true);
    while (true)
        loop();
}
