/* As much of the Pico SDK and of TinyUSB as firmware/examples/tinyusb_rp2040 calls, for a host without either. Names and
 * types are those of pico-sdk 2 and TinyUSB 0.17. */
#ifndef PICO_STUB_H
#define PICO_STUB_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

typedef unsigned int uint;

/* pico/stdlib.h, hardware/gpio.h */
#define GPIO_IRQ_EDGE_FALL 4u
void gpio_init(uint pin);
void gpio_set_dir(uint pin, bool output);
void gpio_pull_up(uint pin);
void gpio_put(uint pin, bool high);
bool gpio_get(uint pin);
void gpio_set_irq_enabled_with_callback(uint pin, uint32_t events, bool on, void (*callback)(uint, uint32_t));

typedef uint64_t absolute_time_t;
absolute_time_t get_absolute_time(void);
uint32_t to_ms_since_boot(absolute_time_t at);

typedef int32_t alarm_id_t;
typedef int64_t (*alarm_callback_t)(alarm_id_t alarm, void *context);
alarm_id_t add_alarm_in_us(uint64_t us, alarm_callback_t callback, void *context, bool fire_if_past);
bool cancel_alarm(alarm_id_t alarm);

typedef struct repeating_timer {
    int64_t delay_us;
} repeating_timer_t;
typedef bool (*repeating_timer_callback_t)(repeating_timer_t *timer);
bool add_repeating_timer_us(int64_t us, repeating_timer_callback_t callback, void *context, repeating_timer_t *timer);

/* pico/rand.h, pico/unique_id.h */
#define PICO_UNIQUE_BOARD_ID_SIZE_BYTES 8
uint32_t get_rand_32(void);
void pico_get_unique_board_id_string(char *id, uint length);

/* hardware/adc.h, hardware/flash.h, hardware/sync.h, hardware/watchdog.h */
void adc_init(void);
void adc_gpio_init(uint pin);
void adc_select_input(uint input);
uint16_t adc_read(void);

#define PICO_FLASH_SIZE_BYTES 8192u
#define FLASH_SECTOR_SIZE 4096u
#define FLASH_PAGE_SIZE 256u
extern uint8_t stub_flash[PICO_FLASH_SIZE_BYTES];
#define XIP_BASE ((uintptr_t)stub_flash)
void flash_range_erase(uint32_t offset, size_t count);
void flash_range_program(uint32_t offset, const uint8_t *data, size_t count);

uint32_t save_and_disable_interrupts(void);
void restore_interrupts(uint32_t status);
bool watchdog_caused_reboot(void);
void watchdog_enable(uint32_t delay_ms, bool pause_on_debug);
void watchdog_update(void);

/* tusb.h */
#define OPT_MODE_DEVICE 1
#include "tusb_config.h"

typedef enum { HID_REPORT_TYPE_INVALID, HID_REPORT_TYPE_INPUT, HID_REPORT_TYPE_OUTPUT, HID_REPORT_TYPE_FEATURE } hid_report_type_t;
enum { HID_ITF_PROTOCOL_NONE };
enum { TUSB_DESC_DEVICE = 1, TUSB_DESC_STRING = 3 };

typedef struct __attribute__((packed)) {
    uint8_t bLength, bDescriptorType;
    uint16_t bcdUSB;
    uint8_t bDeviceClass, bDeviceSubClass, bDeviceProtocol, bMaxPacketSize0;
    uint16_t idVendor, idProduct, bcdDevice;
    uint8_t iManufacturer, iProduct, iSerialNumber, bNumConfigurations;
} tusb_desc_device_t;

#define TUD_CONFIG_DESC_LEN 9
#define TUD_HID_INOUT_DESC_LEN (9 + 9 + 7 + 7)
#define STUB_U16(value) (uint8_t)((value)&0xFF), (uint8_t)((value) >> 8)
#define TUD_CONFIG_DESCRIPTOR(number, interfaces, string, length, attribute, power_ma)                                 \
    9, 2, STUB_U16(length), interfaces, number, string, 0x80 | (attribute), (power_ma) / 2
#define TUD_HID_INOUT_DESCRIPTOR(interface, string, protocol, report_length, out, in, size, ms)                        \
    9, 4, interface, 0, 2, 3, 0, protocol, string, 9, 0x21, STUB_U16(0x0111), 0, 1, 0x22, STUB_U16(report_length), 7,  \
        5, out, 3, STUB_U16(size), ms, 7, 5, in, 3, STUB_U16(size), ms

const uint8_t *tud_descriptor_device_cb(void);
const uint8_t *tud_descriptor_configuration_cb(uint8_t index);
const uint8_t *tud_hid_descriptor_report_cb(uint8_t instance);
const uint16_t *tud_descriptor_string_cb(uint8_t index, uint16_t language);
uint16_t tud_hid_get_report_cb(uint8_t instance, uint8_t id, hid_report_type_t type, uint8_t *buffer, uint16_t length);
void tud_hid_set_report_cb(uint8_t instance, uint8_t id, hid_report_type_t type, const uint8_t *buffer, uint16_t length);
bool tusb_init(void);
void tud_task(void);
bool tud_hid_ready(void);
bool tud_hid_report(uint8_t id, const void *report, uint16_t length);

#endif
