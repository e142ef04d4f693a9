#include "player.h"

#include "device_time.h"
#include "tactable_protocol.h"

#define WAVEFORMS_AT_ONCE 2

void player_start(struct player *player)
{
    *player = (struct player){.end_us = NEVER_US};
}

bool player_has_room(const struct player *player, uint64_t now_us)
{
    const int fading = (player->fade_ends_us[0] > now_us) + (player->fade_ends_us[1] > now_us);
    return fading + (player->end_us != NEVER_US) < WAVEFORMS_AT_ONCE;
}

void player_play(struct player *player, uint64_t now_us, uint32_t length_us, uint16_t amplitude)
{
    player->end_us = now_us + length_us;
    player->amplitude = amplitude;
}

void player_take_over(struct player *player, uint64_t now_us, uint16_t slew_per_s)
{
    if (player->end_us == NEVER_US) {
        return;
    }
    const uint32_t slew = TACTABLE_FULL_SCALE_WORD * slew_per_s;
    const uint64_t faded_us = now_us + ((uint64_t)player->amplitude * US_PER_S + slew - 1u) / slew;
    /* One place is free: with both in use there would have been no room for the waveform that plays. */
    uint64_t *place = &player->fade_ends_us[player->fade_ends_us[0] > now_us];
    *place = faded_us < player->end_us ? faded_us : player->end_us;
    player_finish(player);
}

void player_finish(struct player *player)
{
    player->end_us = NEVER_US;
}
