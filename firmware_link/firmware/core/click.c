#include "click.h"

#include "device_time.h"

#define SAMPLE_SIZE 2u
#define SAMPLE_FULL_SCALE 32767u
/* 2 pi as a fraction of small integers, 9e-8 too great. */
#define TURN_NUMERATOR 710u
#define TURN_DENOMINATOR 113u

/* value / 2^bits, rounded down: what `>>` makes of a negative value is the compiler's choice. */
static int64_t floor_shift(int64_t value, uint8_t bits)
{
    const int64_t one_less = ((int64_t)1 << bits) - 1;
    return value >= 0 ? value >> bits : -((one_less - value) >> bits);
}

static int32_t clamped(int64_t value, int64_t low, int64_t high)
{
    return (int32_t)(value < low ? low : value > high ? high : value);
}

void click_start(struct click *click, const struct basis_set *set, const uint8_t *play_body, uint8_t fraction_bits)
{
    click->set = *set;
    click->fraction_bits = fraction_bits;
    click->at = 0;
    for (size_t i = 0; i < TACTABLE_ACTUATORS; i++) {
        click->before[i] = click->after[i] = 0;
    }
    for (uint8_t i = 0; i < set->number_of_functions; i++) {
        click->weights[i] = tactable_read_play_item(play_body, i).weight;
    }
}

void click_limit(struct click *click, uint8_t actuator, uint16_t amplitude, uint32_t frequency_maximum_uhz)
{
    const uint32_t limit = amplitude * SAMPLE_FULL_SCALE / TACTABLE_FULL_SCALE_WORD;
    const uint64_t turn = (uint64_t)TURN_DENOMINATOR * click->set.sample_rate_hz * US_PER_S;
    const uint64_t step = ((uint64_t)limit * frequency_maximum_uhz * TURN_NUMERATOR + turn - 1u) / turn;
    click->limit[actuator] = (int32_t)limit;
    click->step[actuator] = (int32_t)step;
}

/* Computes the sample after `before`. */
static void compute_after(struct click *click, uint8_t number_of_actuators)
{
    int64_t sums[TACTABLE_ACTUATORS];
    for (uint8_t i = 0; i < number_of_actuators; i++) {
        sums[i] = 0;
    }
    const struct basis_set *set = &click->set;
    const uint32_t index = click->at + 1u;
    const uint8_t *sample = set->samples + (size_t)SAMPLE_SIZE * set->number_of_functions * index;
    for (uint8_t i = 0; i < set->number_of_functions; i++, sample += SAMPLE_SIZE) {
        sums[set->actuators[i]] += (int32_t)click->weights[i] * (int16_t)get_u16(sample);
    }
    /* Towards the end the bound is what can still return to 0 by steps. */
    const int64_t remaining = (int64_t)set->number_of_samples - 1 - index;
    const int64_t half = (int64_t)1 << (click->fraction_bits - 1u);
    for (uint8_t i = 0; i < number_of_actuators; i++) {
        const int64_t step = click->step[i];
        const int64_t bound = step * remaining < click->limit[i] ? step * remaining : click->limit[i];
        const int64_t bounded = clamped(floor_shift(sums[i] + half, click->fraction_bits), -bound, bound);
        click->after[i] = clamped(bounded, click->before[i] - step, click->before[i] + step);
    }
}

void click_begin(struct click *click, uint8_t number_of_actuators)
{
    compute_after(click, number_of_actuators);
}

void click_next(struct click *click, uint8_t number_of_actuators)
{
    click->at++;
    for (uint8_t i = 0; i < number_of_actuators; i++) {
        click->before[i] = click->after[i];
    }
    compute_after(click, number_of_actuators);
}
