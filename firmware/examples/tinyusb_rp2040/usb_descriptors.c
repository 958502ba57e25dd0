/* What the rig says of itself to the USB host: one HID interface, interrupt in and out, 64 bytes each millisecond. */
#include <string.h>

#include "kinran_rig.h"
#include "pico/unique_id.h"
#include "tusb.h"

#define USB_VENDOR 0x1209 /* 1209:0001 is a pair for tests: ask pid.codes for one of your own */
#define USB_PRODUCT 0x0001
#define ENDPOINT_OUT 0x01
#define ENDPOINT_IN 0x81

enum string_index { LANGUAGE, MANUFACTURER, PRODUCT, SERIAL };

static const tusb_desc_device_t DEVICE = {
    .bLength = sizeof(tusb_desc_device_t),
    .bDescriptorType = TUSB_DESC_DEVICE,
    .bcdUSB = 0x0200,
    .bMaxPacketSize0 = CFG_TUD_ENDPOINT0_SIZE,
    .idVendor = USB_VENDOR,
    .idProduct = USB_PRODUCT,
    .bcdDevice = 0x0100,
    .iManufacturer = MANUFACTURER,
    .iProduct = PRODUCT,
    .iSerialNumber = SERIAL,
    .bNumConfigurations = 1,
};

static const uint8_t REPORTS[] = {RIG_DESCRIPTOR};

static const uint8_t CONFIGURATION[] = {
    TUD_CONFIG_DESCRIPTOR(1, 1, 0, TUD_CONFIG_DESC_LEN + TUD_HID_INOUT_DESC_LEN, 0, 100),
    TUD_HID_INOUT_DESCRIPTOR(0, 0, HID_ITF_PROTOCOL_NONE, sizeof REPORTS, ENDPOINT_OUT, ENDPOINT_IN, 64, 1),
};

const uint8_t *tud_descriptor_device_cb(void) {
    return (const uint8_t *)&DEVICE;
}

const uint8_t *tud_descriptor_configuration_cb(uint8_t index) {
    (void)index;
    return CONFIGURATION;
}

const uint8_t *tud_hid_descriptor_report_cb(uint8_t instance) {
    (void)instance;
    return REPORTS;
}

const uint16_t *tud_descriptor_string_cb(uint8_t index, uint16_t language) {
    static uint16_t text[1 + 2 * PICO_UNIQUE_BOARD_ID_SIZE_BYTES];
    char serial[2 * PICO_UNIQUE_BOARD_ID_SIZE_BYTES + 1];
    const char *from;
    unsigned length = 0;
    (void)language;
    switch (index) {
    case LANGUAGE:
        text[1] = 0x0409; /* English */
        text[0] = TUSB_DESC_STRING << 8 | 4;
        return text;
    case MANUFACTURER:
        from = "Kinran";
        break;
    case PRODUCT:
        from = "goniometer";
        break;
    case SERIAL:
        pico_get_unique_board_id_string(serial, sizeof serial);
        from = serial;
        break;
    default:
        return NULL;
    }
    for (; from[length] && length < sizeof text / sizeof *text - 1; length++)
        text[1 + length] = (uint8_t)from[length];
    text[0] = (uint16_t)(TUSB_DESC_STRING << 8 | (2 * length + 2));
    return text;
}
