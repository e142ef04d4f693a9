/* Player: when each waveform ends, from its start and from what takes over from it. */
#ifndef TACTABLE_PLAYER_H
#define TACTABLE_PLAYER_H

#include <stdbool.h>
#include <stdint.h>

/* One waveform plays, and one that it took over from may fade: at most two sound. */
struct player {
    uint64_t end_us; /* when the waveform that plays ends by itself; NEVER_US while none plays */
    uint64_t fade_ends_us[2];
    uint16_t amplitude;
};

void player_start(struct player *player);

bool player_has_room(const struct player *player, uint64_t now_us);

/* Plays a waveform, after player_take_over() of the one that played. */
void player_play(struct player *player, uint64_t now_us, uint32_t length_us, uint16_t amplitude);

/* Lets the waveform that plays fade. */
void player_take_over(struct player *player, uint64_t now_us, uint16_t slew_per_s);

/* Notes that the waveform that plays has ended. */
void player_finish(struct player *player);

#endif
