#include "framing.h"

#include "crc32.h"

#define DELIMITER 0u
#define SHORTEST_BODY 2u

static const struct tactable_layout layouts[] = {TACTABLE_LAYOUTS};
#define NUMBER_OF_LAYOUTS (sizeof layouts / sizeof layouts[0])

static const struct tactable_layout *layout_of(uint8_t type)
{
    for (size_t i = 0; i < NUMBER_OF_LAYOUTS; i++) {
        if (layouts[i].type == type) {
            return &layouts[i];
        }
    }
    return NULL;
}

static size_t body_length(const struct tactable_layout *layout, uint8_t repetitions)
{
    return layout->length + (size_t)layout->length_each * repetitions;
}

static size_t longest_stuffed_length(uint8_t number_of_actuators)
{
    size_t longest = 0;
    for (size_t i = 0; i < NUMBER_OF_LAYOUTS; i++) {
        const size_t length = body_length(&layouts[i], layouts[i].most != 0 ? layouts[i].most : number_of_actuators);
        longest = length > longest ? length : longest;
    }
    return COBS_BOUND(longest + FRAMING_CHECKSUM_SIZE);
}

/* A HELLO says its own number of actuators and a PLAY its number of weights, in the byte before what is repeated. */
static bool has_exact_length(const struct tactable_layout *layout, const uint8_t *body, size_t length, uint8_t actuators)
{
    uint8_t repetitions = actuators;
    if ((layout->most != 0 || layout->type == TACTABLE_HELLO_TYPE) && length >= layout->length) {
        repetitions = body[layout->length - 1u];
    }
    return length == body_length(layout, repetitions) && (layout->most == 0 || repetitions <= layout->most);
}

/* Whether a run between delimiters is a frame; counts it either way. */
static bool accept(struct framing *framing)
{
    size_t content = framing->held;
    if (!cobs_decode(framing->buffer, &content)) {
        framing->counters.framing++;
        return false;
    }
    if (content < SHORTEST_BODY + FRAMING_CHECKSUM_SIZE) {
        framing->counters.length++;
        return false;
    }
    const size_t length = content - FRAMING_CHECKSUM_SIZE;
    const struct tactable_layout *layout = layout_of(framing->buffer[0]);
    const uint32_t checksum = get_u32(framing->buffer + length);
    if (layout == NULL || crc32_of(framing->buffer, length, layout->seed) != checksum) {
        framing->counters.crc++;
        return false;
    }
    if (!has_exact_length(layout, framing->buffer, length, framing->number_of_actuators)) {
        framing->counters.length++;
        return false;
    }
    framing->length = length;
    framing->counters.ok++;
    return true;
}

static void extend(struct framing *framing, uint8_t byte)
{
    if (framing->is_discarding) {
        return;
    }
    if (framing->held == framing->capacity) {
        framing->counters.overrun++;
        framing->held = 0;
        framing->is_discarding = true;
        return;
    }
    framing->buffer[framing->held++] = byte;
}

static enum framing_item end_run(struct framing *framing)
{
    const bool is_empty = framing->held == 0 && !framing->is_discarding;
    framing->is_discarding = false;
    if (!is_empty) {
        framing->delimiters_in_a_row = 1;
    } else if (framing->delimiters_in_a_row <= TACTABLE_EMERGENCY_STOP_RUN) {
        /* The count stops one above the run, which is enough to report it only once. */
        framing->delimiters_in_a_row++;
    }
    if (framing->delimiters_in_a_row == TACTABLE_EMERGENCY_STOP_RUN) {
        return FRAMING_EMERGENCY_STOP;
    }
    const bool is_body = framing->held != 0 && accept(framing);
    framing->held = 0;
    return is_body ? FRAMING_BODY : FRAMING_NOTHING;
}

void framing_start(struct framing *framing, uint8_t number_of_actuators)
{
    *framing = (struct framing){.number_of_actuators = number_of_actuators};
    framing->capacity = longest_stuffed_length(number_of_actuators);
}

enum framing_item framing_take(struct framing *framing, uint8_t byte)
{
    if (byte == DELIMITER) {
        return end_run(framing);
    }
    extend(framing, byte);
    return FRAMING_NOTHING;
}

size_t framing_encode(uint8_t *body, size_t length, uint8_t *frame)
{
    const uint32_t checksum = crc32_of(body, length, layout_of(body[0])->seed);
    put_u32(body + length, checksum);
    const size_t stuffed = cobs_encode(body, length + FRAMING_CHECKSUM_SIZE, frame);
    frame[stuffed] = DELIMITER;
    return stuffed + 1u;
}
