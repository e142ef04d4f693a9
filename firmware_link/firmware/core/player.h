/* Starts and takeovers of waveforms to when each of them ends. */
#ifndef TACTABLE_PLAYER_H
#define TACTABLE_PLAYER_H

#include <stdbool.h>
#include <stdint.h>

/* One waveform plays and one that it took over from may fade: two sound at most. */
struct player {
    uint64_t end_us; /* when the one that plays ends by itself; NEVER_US while none plays */
    uint64_t fade_ends_us[2];
    uint16_t amplitude;
};

void player_start(struct player *player);

bool player_has_room(const struct player *player, uint64_t now_us);

/* Plays one, when what played before has been taken over. */
void player_play(struct player *player, uint64_t now_us, uint32_t length_us, uint16_t amplitude);

/* Lets the one that plays fade. */
void player_take_over(struct player *player, uint64_t now_us, uint16_t slew_per_s);

/* The one that plays has ended. */
void player_finish(struct player *player);

#endif
