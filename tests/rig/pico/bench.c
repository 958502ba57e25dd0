/* A Pico on a bench: its pins turn arms that know where they stand, and press home switches. It runs the example's own
 * main.c, whose loop and interrupt are called from here. */
#define main example_main
#include "main.c"
#undef main

#define REPORTS 256u

static int32_t arms[RIG_AXES] = {8889, 2400, 0, 0}; /* steps from 0: 20 and 15 degrees */
static bool pins[32];
static uint32_t ms;
static repeating_timer_callback_t interrupt;
static alarm_callback_t alarm;
static uint64_t alarm_us;
static void (*edge)(uint, uint32_t);
static uint8_t heard[REPORTS][RIG_REPORT];
static unsigned unread;
uint8_t stub_flash[PICO_FLASH_SIZE_BYTES];

void gpio_init(uint pin) { pins[pin] = false; }
void gpio_set_dir(uint pin, bool output) { (void)pin, (void)output; }
void gpio_pull_up(uint pin) { (void)pin; }
bool gpio_get(uint pin) {
    for (unsigned i = 0; i < RIG_AXES; i++)
        if (pin == MOTORS[i].home)
            return arms[i] > to_steps(i, MOTORS[i].home_mdeg);
    return pins[pin];
}
void gpio_put(uint pin, bool high) {
    for (unsigned i = 0; i < RIG_AXES; i++)
        if (pin == MOTORS[i].step && high && !pins[pin])
            arms[i] += pins[MOTORS[i].dir] ? 1 : -1;
    if (pin == RELEASE && high && !pins[pin])
        edge(X_SYNC, GPIO_IRQ_EDGE_FALL);
    pins[pin] = high;
}
void gpio_set_irq_enabled_with_callback(uint pin, uint32_t events, bool on, void (*callback)(uint, uint32_t)) {
    (void)pin, (void)events, (void)on;
    edge = callback;
}
absolute_time_t get_absolute_time(void) { return ms; }
uint32_t to_ms_since_boot(absolute_time_t at) { return (uint32_t)at; }
alarm_id_t add_alarm_in_us(uint64_t us, alarm_callback_t callback, void *context, bool fire_if_past) {
    (void)context, (void)fire_if_past;
    alarm = callback;
    alarm_us = us;
    return 1;
}
bool cancel_alarm(alarm_id_t id) {
    (void)id;
    alarm = NULL;
    return true;
}
bool add_repeating_timer_us(int64_t us, repeating_timer_callback_t callback, void *context, repeating_timer_t *timer) {
    (void)context, (void)timer;
    interrupt = callback;
    return us == -20;
}
uint32_t get_rand_32(void) { return 0x12345678u + ms; }
void pico_get_unique_board_id_string(char *id, uint length) { strncpy(id, "E66118604B2C5B2A", length); }
void adc_init(void) {}
void adc_gpio_init(uint pin) { (void)pin; }
void adc_select_input(uint input) { (void)input; }
uint16_t adc_read(void) { return pins[LAMP] ? 3000 : 10; }
void flash_range_erase(uint32_t offset, size_t count) { memset(stub_flash + offset, 0xFF, count); }
void flash_range_program(uint32_t offset, const uint8_t *data, size_t count) {
    memcpy(stub_flash + offset, data, count);
}
uint32_t save_and_disable_interrupts(void) { return 0; }
void restore_interrupts(uint32_t status) { (void)status; }
bool watchdog_caused_reboot(void) { return false; }
void watchdog_enable(uint32_t delay_ms, bool pause) { (void)delay_ms, (void)pause; }
void watchdog_update(void) {}
bool tusb_init(void) { return true; }
void tud_task(void) {}
bool tud_hid_ready(void) { return unread < REPORTS; }
bool tud_hid_report(uint8_t id, const void *report, uint16_t length) {
    heard[unread][0] = id;
    memcpy(heard[unread++] + 1, report, length);
    return true;
}

/* -- what the test calls --------------------------------------------------------------------------------------------- */

void bench_start(void);
void bench_advance(uint32_t count);
bool bench_read(uint8_t *report);
int32_t bench_arm(unsigned axis);
bool bench_pin(unsigned pin);

void bench_start(void) {
    set_up();
    pico_get_unique_board_id_string(maker.serial, 16);
    rig_init(&rig, &HARDWARE, &maker, kept(), 0, ms);
}

void bench_advance(uint32_t count) {
    while (count--) {
        ms++;
        loop();
        for (unsigned i = 0; i < STEPS_PER_MS; i++)
            interrupt(NULL);
        if (alarm && alarm_us <= 1000)
            alarm(1, NULL), alarm = NULL;
        else if (alarm)
            alarm_us -= 1000;
    }
}

bool bench_read(uint8_t *report) {
    if (!unread)
        return false;
    memcpy(report, heard[0], RIG_REPORT);
    memmove(heard[0], heard[1], RIG_REPORT * --unread);
    return true;
}

/* Where an arm really stands, in millidegrees. */
int32_t bench_arm(unsigned axis) { return to_mdeg(axis, arms[axis]); }
bool bench_pin(unsigned pin) { return pins[pin]; }
