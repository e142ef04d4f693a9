/* The compiled step: waits, and answers a report with its command, for engine/loop/fast/fast_path.py.
 *
 * `fast_wait` sleeps until a descriptor can be read or a time has come. It reads a report that is there and, where the
 * report completes a frame that brings another command, writes the command at once. It answers with clicks of one finger
 * and of two, with drives of zones, and with silence. Python fills the structure `Fast`
 * before each wait. The step changes none of that state: the Python loop takes the same report afterwards and must find
 * the same bytes. Each part below repeats a part of the Python pipeline, by the same arithmetic. What is rare is left to
 * the loop: DECLINED.
 */
#define _GNU_SOURCE
#include <errno.h>
#include <math.h>
#include <poll.h>
#include <string.h>
#include <sys/timerfd.h>
#include <time.h>
#include <unistd.h>

#include "layout.h"

enum { DECLINED, ANSWERED };

static int64_t virtual_ns = NONE;

/* For tests: the time from now on; NONE: that of the clock. */
void fast_set_time(int64_t time_ns) { virtual_ns = time_ns; }

static int64_t now_ns(void) {
    if (virtual_ns != NONE) return virtual_ns;
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return (int64_t)now.tv_sec * 1000000000 + now.tv_nsec;
}

/* ---- report to contacts, as engine/touch/digitizer.py ---- */

static int64_t get(const uint8_t *report, const Bits *bits) {
    uint64_t value; /* may read behind the report: the packet has ROOM_BEHIND */
    memcpy(&value, report + bits->byte, sizeof value);
    return (int64_t)(value >> bits->shift & (uint64_t)bits->mask);
}

static int find_active(const Active *active, int64_t count, int64_t contact_id) {
    for (int i = 0; i < count; i++)
        if (active[i].contact_id == contact_id) return i;
    return NONE;
}

/* Whether there is room for a new contact, as Digitizer._admit. */
static int admits(const Fast *fast, int64_t contact_id, int64_t *taken) {
    if (fast->key == KEY_ID) return ++*taken <= fast->maximum_contacts;
    if (fast->key == KEY_SLOT_FROM_ONE) return contact_id >= 1 && contact_id <= fast->maximum_contacts;
    return contact_id < fast->maximum_contacts;
}

/* Number of contacts of the frame that the report completes; NONE: it completes none, or the case is left to Python. */
static int decode(const Fast *fast, const uint8_t *report, int64_t size, int64_t time_ns, Active *active) {
    /* Which of the device's reports it is. */
    const int64_t report_id = fast->uses_report_ids ? report[0] : 0;
    const Plan *plan = NULL;
    for (int i = 0; i < fast->plans; i++)
        if (fast->plan[i].report_id == report_id) plan = &fast->plan[i];
    if (plan == NULL || size < plan->needed_bytes) return NONE;
    /* A gap or another scan time inside a frame means a lost report: Python counts it. */
    const int64_t ticks = plan->scan_time.mask ? get(report, &plan->scan_time) : fast->ticks;
    const int is_late = time_ns - fast->report_ns > FRAME_SILENCE_NS;
    if (fast->received && fast->count_is_accurate && (is_late || ticks != fast->ticks)) return NONE;
    /* The first report of a frame carries the contact count, the others 0. */
    int64_t expected = fast->expected, received = fast->received, taken = fast->taken;
    if (plan->count.mask) {
        const int64_t announced = get(report, &plan->count);
        if (announced || (received == 0 && ticks != fast->ticks && fast->frame_may_be_empty)) expected = announced;
    }
    /* Contacts in range so far, changed by each slot of the report in order. */
    int64_t gone[MOST_CONTACTS], gone_count = 0; /* contacts that this report lifted */
    int count = (int)fast->actives;
    memcpy(active, fast->active, (size_t)count * sizeof *active);
    const int64_t wanted = fast->count_is_accurate ? expected : received + plan->slots;
    for (int i = 0; i < plan->slots && received < wanted; i++) {
        const Slot *slot = &plan->slot[i];
        if (slot->valid.mask && !get(report, &slot->valid)) { received++; continue; }
        const int64_t contact_id = fast->key == KEY_NUMBER ? received : get(report, &slot->contact_id);
        int at = find_active(active, count, contact_id);
        if (at != NONE && fast->ignores_duplicates && active[at].seen) continue;
        received++;
        if (at == NONE && !admits(fast, contact_id, &taken)) continue;
        const int tip = get(report, &slot->tip) != 0;
        if ((tip || at != NONE) && slot->confidence.mask && !get(report, &slot->confidence))
            return NONE; /* a palm: left to Python */
        if (!tip && !get(report, &slot->hover)) {
            if (at != NONE) {
                memmove(active + at, active + at + 1, (size_t)(--count - at) * sizeof *active);
                if (gone_count == MOST_CONTACTS) return NONE;
                gone[gone_count++] = contact_id;
            }
            continue;
        }
        if (at == NONE) {
            for (int k = 0; k < gone_count; k++)
                if (gone[k] == contact_id) return NONE; /* lifted and came back in one report: left to Python */
            if (count == MOST_CONTACTS) return NONE;
            at = count++;
            active[at].contact_id = contact_id;
        }
        /* The coordinates along the sides of the surface, clamped to their logical ranges; 0 without a second side. */
        for (int side = 0; side < SIDES; side++) {
            const Place *read = &slot->place[side];
            int64_t place = (get(report, &read->bits) ^ read->sign) - read->sign;
            if (place < read->minimum) place = read->minimum;
            if (place > read->maximum) place = read->maximum;
            active[at].place[side] = place;
        }
        active[at].tip = tip, active[at].seen = 1;
    }
    if (received < expected) return NONE; /* the frame goes on in another report */
    if (fast->unseen_means_up) {
        int kept = 0;
        for (int i = 0; i < count; i++)
            if (active[i].seen) active[kept++] = active[i];
        count = kept;
    }
    return count;
}

/* ---- contacts to points of the surface and zones, as engine/touch/finger_tracker.py ---- */

static double along(const Side *side, int64_t place) {
    return side->start_m + (double)(place - side->zero) * side->m_per_unit;
}

static double clipped(double m, double length_m) { return m >= 0.0 && m <= length_m ? m : m < 0.0 ? 0.0 : length_m; }

static Point point_of(const Fast *fast, const int64_t *place) {
    Point point;
    for (int i = 0; i < SIDES; i++) point.m[i] = clipped(along(&fast->side[i], place[i]), fast->side[i].length_m);
    return point;
}

/* Whether a contact that comes down is too far beyond an edge of the surface to be a finger of it. */
static int is_beside(const Fast *fast, const int64_t *place) {
    for (int i = 0; i < SIDES; i++) {
        const double m = along(&fast->side[i], place[i]);
        if (!(m >= -fast->reach_m && m <= fast->side[i].length_m + fast->reach_m)) return 1;
    }
    return 0;
}

static double distance_m(Point a, Point b) { return hypot(a.m[0] - b.m[0], a.m[1] - b.m[1]); }

static int is_between(Point point, Point start, Point stop) {
    for (int i = 0; i < SIDES; i++)
        if (!(start.m[i] <= point.m[i] && point.m[i] <= stop.m[i])) return 0;
    return 1;
}

/* The zone of a finger that comes down, the last of those that share an edge: hysteresis is for fingers that move, and
 * only the loop follows those. */
static int64_t zone_of(const Fast *fast, Point point) {
    int64_t zone = fast->zones - 1;
    while (zone >= 0 && !is_between(point, fast->zone_start[zone], fast->zone_stop[zone])) zone--;
    return zone; /* -1 is NONE */
}

/* ---- fingers to what is felt, as engine/effects/effect_player.py ---- */

typedef struct { Point held, ahead; int64_t level, click_ns, touches; } Present; /* `ahead` is what clicks are made for */

/* What the fingers bring: the wanted level, when its click began, and the fingers, those that have lifted included. */
typedef struct { int64_t level, click_ns, count; Present finger[3 * MOST_CONTACTS]; } Felt;

/* The click that began last is all that is felt; of equal ones, and of steady levels, the greatest level. */
static void feel(Felt *felt, Point held, Point ahead, int64_t level, int64_t click_ns, int64_t touches) {
    felt->finger[felt->count++] = (Present){held, ahead, level, click_ns, touches};
    if (level == NONE) return;
    if (click_ns == felt->click_ns) {
        if (level > felt->level) felt->level = level;
    } else if (click_ns > felt->click_ns) { /* NONE is below all */
        felt->level = level, felt->click_ns = click_ns;
    }
}

static const Rule *rule_for(const Fast *fast, int64_t trigger, int64_t zone, Point point) {
    for (int i = 0; i < fast->rules; i++) {
        const Rule *rule = &fast->rule[i];
        if (rule->trigger != trigger) continue;
        const int has_zone = rule->zones == NONE || (zone != NONE && rule->zones >> zone & 1);
        if (rule->has_region ? is_between(point, rule->start, rule->stop) : has_zone) return rule;
    }
    return NULL;
}

/* The position that drives are made for: it follows a finger that is more than follow_m away from it. */
static Point held_of(const Fast *fast, const Finger *finger, Point point) {
    return distance_m(point, finger->held) > fast->follow_m ? point : finger->held;
}

/* Where the finger will be at the peak of a click that begins now, as Finger.ahead_m. */
static Point ahead_of(const Fast *fast, const Finger *finger, Point point, int64_t time_ns) {
    const int is_late = time_ns - finger->late_ns >= SPEED_NS;
    const int64_t span_ns = time_ns - (is_late ? finger->late_ns : finger->early_ns);
    const Point from = is_late ? finger->late : finger->early, held = held_of(fast, finger, point);
    if (!fast->ahead_ns || span_ns < SPEED_NS) return held;
    const double spans = (double)fast->ahead_ns / (double)span_ns;
    Point step = {{(point.m[0] - from.m[0]) * spans, (point.m[1] - from.m[1]) * spans}};
    const double way_m = hypot(step.m[0], step.m[1]), part = fast->furthest_m / way_m;
    if (way_m <= fast->follow_m) return held;
    for (int i = 0; i < SIDES; i++) {
        if (way_m > fast->furthest_m) step.m[i] *= part;
        step.m[i] = clipped(point.m[i] + step.m[i], fast->side[i].length_m);
    }
    return step;
}

/* Whether a finger came or lifted; `felt` is what the contacts bring. */
static int follow(const Fast *fast, const Active *active, int count, int64_t time_ns, Felt *felt) {
    /* Fingers that touch: their effect, or the one that a touch rule gives them. */
    int changed = 0, touching = 0;
    int64_t here[MOST_CONTACTS];
    for (int i = 0; i < count; i++) {
        if (!active[i].tip) continue;
        const Point point = point_of(fast, active[i].place);
        const Finger *finger = NULL;
        for (int k = 0; k < fast->fingers; k++)
            if (fast->finger[k].contact_id == active[i].contact_id) finger = &fast->finger[k];
        if (finger == NULL && is_beside(fast, active[i].place)) continue;
        here[touching++] = active[i].contact_id;
        if (finger != NULL) {
            if (fast->follows_moves && distance_m(point, finger->position) != 0.0) return 0; /* a drag, or the end of a hold */
            const Point ahead = ahead_of(fast, finger, point, time_ns);
            feel(felt, held_of(fast, finger, point), ahead, finger->level, finger->click_ns, 1);
        } else {
            const Rule *rule = rule_for(fast, TOUCH, zone_of(fast, point), point);
            changed = 1;
            feel(felt, point, point, rule ? rule->level : NONE, rule && rule->is_click ? time_ns : NONE, 1);
        }
    }
    /* Fingers that have just lifted, by their lift rule; then those lifted before, whose effect goes on. */
    for (int k = 0; k < fast->fingers + fast->lifted; k++) {
        const Finger *finger = &fast->finger[k];
        if (k < fast->fingers) {
            int is_here = 0;
            for (int i = 0; i < touching; i++) is_here |= here[i] == finger->contact_id;
            if (is_here) continue;
            changed = 1;
            const Rule *rule = rule_for(fast, LIFT, finger->zone, finger->position);
            if (rule == NULL) continue;
            feel(felt, finger->held, finger->held, rule->level, rule->is_click ? time_ns : NONE, 0);
        } else {
            feel(felt, finger->held, finger->held, finger->level, finger->click_ns, 0);
        }
    }
    return changed;
}

/* ---- placement to click, as engine/table/clicks.py ---- */

/* The nearest place; they are numbered along the surface first, as engine/touch/placement.py has it. */
static int64_t place_of(const Fast *fast, Point point) {
    int64_t number = 0;
    for (int i = 0; i < SIDES; i++) {
        const Side *side = &fast->side[i];
        const int64_t place = (int64_t)(point.m[i] / side->pitch_m + 0.5), last = side->places - 1;
        number = side->places * number + (place < 0 ? 0 : place > last ? last : place);
    }
    return number;
}

/* Row of the click for these fingers; NONE: there is none, or the case is left to Python. */
static int64_t row_of(const Fast *fast, const Felt *felt) {
    /* The felt fingers, and all others that touch; code 0 stands for no finger, 1 + 2 * place + is_felt for one. The
     * finger that came last has the last code: `warm` has brought the row of the code before it. */
    Point ahead[MOST_FINGERS] = {0};
    int64_t code[MOST_FINGERS] = {0}, count = 0;
    for (int i = 0; i < felt->count; i++) {
        const Present *finger = &felt->finger[i];
        const int is_felt = finger->level != NONE && finger->click_ns == felt->click_ns;
        if (!finger->touches && !is_felt) continue;
        if (count == MOST_FINGERS) return NONE;
        ahead[0] = ahead[1], code[0] = code[1], count++;
        ahead[1] = finger->ahead, code[1] = 1 + 2 * place_of(fast, finger->ahead) + is_felt;
    }
    /* Fingers that are too close are one to the surface, or will not be there. */
    if (count == MOST_FINGERS && distance_m(ahead[0], ahead[1]) < fast->closest_m) return NONE;
    return fast->pair[code[0] * (2 * fast->places + 1) + code[1]]; /* in either order */
}

/* Fill in the click of a row at a level, as encode_play of firmware_link/protocol/messages.py; 0: it has none. */
static int play(const Fast *fast, int64_t row, int64_t level, Command *command) {
    const int64_t amplitude = fast->amplitude[level * fast->rows + row];
    if (amplitude == NONE) return 0;
    const uint8_t *head = fast->head + 3 * row; /* set, fraction bits, number of weights */
    uint8_t *body = command->body;
    command->kind = PLAY, command->size = PLAY_HEAD + 2 * head[2];
    body[0] = PLAY_TYPE, body[4] = head[0], body[5] = head[1];
    body[6] = (uint8_t)amplitude, body[7] = (uint8_t)(amplitude >> 8), body[8] = head[2];
    memcpy(body + PLAY_HEAD, fast->weight + row * fast->functions, 2 * (size_t)head[2]); /* this machine is little-endian */
    return 1;
}

/* ---- placement to drive, as ZoneDrives of engine/render/renderer.py ---- */

/* The zones of the fingers that feel, a bit for each; NONE: the case is left to Python. */
static int64_t combination_of(const Fast *fast, const Felt *felt) {
    Point held[MOST_PLACED];
    int64_t zones = 0, count = 0;
    for (int i = 0; i < felt->count; i++) {
        const Present *finger = &felt->finger[i];
        const int is_felt = finger->level != NONE && finger->click_ns == felt->click_ns;
        if (!finger->touches && !is_felt) continue;
        if (count == MOST_PLACED) return NONE; /* some are left out */
        for (int k = 0; k < count; k++)
            if (distance_m(held[k], finger->held) < fast->closest_m) return NONE; /* one finger to the surface */
        held[count++] = finger->held;
        const int64_t zone = zone_of(fast, finger->held);
        if (is_felt && zone != NONE) zones |= (int64_t)1 << zone;
    }
    return zones;
}

/* Fill in the drive of a combination of zones at a level. */
static void set(const Fast *fast, int64_t combination, int64_t level, Command *command) {
    command->kind = SET, command->size = fast->silence.size;
    const uint8_t *drive = fast->drive + ((level << fast->zones) + combination) * command->size;
    memcpy(command->body, drive, (size_t)command->size);
}

/* ---- command to frame, as firmware_link/protocol/framing.py ---- */

static uint32_t checksum_table[256];

void fast_start(void) {
    for (uint32_t i = 0; i < 256; i++) {
        uint32_t value = i;
        for (int bit = 0; bit < 8; bit++) value = value >> 1 ^ (value & 1 ? 0xEDB88320u : 0);
        checksum_table[i] = value;
    }
}

/* Fill in sequence and clock reference, append the checksum, and stuff by COBS; the length of the frame. */
static int64_t encode(const Fast *fast, const Command *command, int64_t reference, uint8_t *frame) {
    uint8_t body[sizeof fast->frame]; /* it gets the checksum too, and a frame is longer yet */
    int64_t size = command->size;
    memcpy(body, command->body, (size_t)size);
    body[1] = (uint8_t)(fast->sequence + 1);
    body[2] = (uint8_t)reference, body[3] = (uint8_t)(reference >> 8);
    uint32_t checksum = ~(uint32_t)fast->seed[command->kind];
    for (int i = 0; i < size; i++) checksum = checksum_table[(checksum ^ body[i]) & 0xFF] ^ checksum >> 8;
    checksum = ~checksum;
    for (int i = 0; i < 4; i++) body[size++] = (uint8_t)(checksum >> 8 * i);
    /* COBS: `block` is where the length of the running block goes, `at` the next byte. No block exceeds 254 bytes. */
    int64_t block = 0, at = 1;
    for (int i = 0; i < size; i++) {
        if (body[i]) {
            frame[at++] = body[i];
        } else {
            frame[block] = (uint8_t)(at - block);
            block = at++;
        }
    }
    frame[block] = (uint8_t)(at - block);
    frame[at++] = 0;
    return at;
}

/* The device's clock at a host time in steps of 100 us, as DeviceClock.device_time_us; NONE before its zero. */
static int64_t reference_at(const Fast *fast, int64_t time_ns) {
    const double drifted_ns = (double)(time_ns - fast->clock_at_ns) * fast->clock_drift;
    const double device_ns = (double)time_ns + fast->clock_middle_ns + drifted_ns;
    if (!(device_ns >= 0.0)) return NONE;
    /* As Python divides: exact for what fmod leaves. */
    const double time_us = floor((device_ns - fmod(device_ns, 1000.0)) / 1000.0 + 0.5);
    return (int64_t)time_us / 100 % 65536;
}

/* ---- the step and the wait ---- */

static int is_readable(int64_t descriptor) {
    struct pollfd asked = {.fd = (int)descriptor, .events = POLLIN};
    return poll(&asked, 1, 0) > 0;
}

/* Encode the frame that the packet brings; DECLINED where it brings none, or the case is left to Python. */
int64_t fast_answer(Fast *fast) {
    Active active[MOST_CONTACTS];
    Felt felt; /* without its fingers: they take longer to clear than to list */
    felt.level = felt.click_ns = NONE, felt.count = 0;
    const uint8_t *report = fast->packet + fast->packet_head;
    int64_t time_ns = fast->read_ns + fast->axis_ns;
    if (fast->packet_head) memcpy(&time_ns, fast->packet, sizeof time_ns); /* a benchmark says when it was due */
    if (fast->packet_size <= fast->packet_head || fast->due_ns <= time_ns) return DECLINED;
    /* Decode, then track and play. */
    const int count = decode(fast, report, fast->packet_size - fast->packet_head, time_ns, active);
    fast->frame_ns = now_ns();
    if (count == NONE || !follow(fast, active, count, time_ns, &felt)) return DECLINED;
    fast->state_ns = now_ns();
    /* Its own are a click that begins now, a drive of zones where no click is felt, and silence after something. A click
     * that goes on keeps its fingers and its level; drives that are solved, and a click that is felt again since a later
     * one was cut, are left to Python. */
    const int is_steady = felt.click_ns == NONE;
    if (felt.level == NONE ? fast->level == NONE
        : is_steady ? fast->click_ns != NONE
                    : felt.click_ns != time_ns || felt.click_ns == fast->click_ns)
        return DECLINED;
    /* Look the command up. */
    Command found;
    const Command *command = &fast->silence;
    if (felt.level != NONE && !is_steady && fast->plays_clicks) {
        const int64_t row = row_of(fast, &felt);
        if (row == NONE || !play(fast, row, felt.level, &found)) return DECLINED;
        command = &found;
    } else if (felt.level != NONE) {
        const int64_t combination = fast->drive ? combination_of(fast, &felt) : NONE;
        if (combination == NONE) return DECLINED;
        set(fast, combination, felt.level, &found);
        command = &found;
    }
    /* What the device holds already is not sent again. */
    if (command->kind == SET && !memcmp(command->body + 4, fast->held.body + 4, (size_t)command->size - 4)) return DECLINED;
    /* Encode it, if the link would send it now. */
    const int64_t asked_ns = fast->asked_ns = now_ns();
    if (asked_ns < fast->line_free_ns) return DECLINED;
    if (asked_ns < (command->kind == PLAY ? fast->play_from_ns : fast->set_from_ns)) return DECLINED;
    const int64_t reference = reference_at(fast, asked_ns);
    if (reference == NONE) return DECLINED;
    fast->frame_size = encode(fast, command, reference, fast->frame);
    fast->command_ns = now_ns();
    return ANSWERED;
}

int fast_open_timer(void) { return timerfd_create(CLOCK_MONOTONIC, TFD_NONBLOCK | TFD_CLOEXEC); }

/* A timer of its own in place of a timeout: the kernel cancels the timeout of a poll when a report comes, and to set the
 * clock on the way from a report to its command is expensive in a virtual machine. */
static void arm(Fast *fast, int64_t until_ns) {
    const int64_t at_ns = until_ns == NONE ? 0 : until_ns > 0 ? until_ns : 1; /* 0 disarms it */
    const struct itimerspec at = {.it_value = {at_ns / 1000000000, at_ns % 1000000000}};
    timerfd_settime((int)fast->timer, TFD_TIMER_ABSTIME, &at, NULL);
    fast->armed_ns = until_ns;
}

/* Bring into the caches what an answer needs: Python drove it out while it checked the last one. That is the code that
 * composes a frame, the table of the checksum, and where a finger beside the last one finds its row. The frame made here
 * is not sent: its size stays 0. */
static void warm(Fast *fast) {
    if (!fast->can_answer) return;
    Command click;
    encode(fast, fast->rows && play(fast, 0, 0, &click) ? &click : &fast->silence, 0, fast->frame);
    if (!fast->rows) return;
    const int64_t codes = 2 * fast->places + 1;
    const int64_t code = fast->fingers ? 1 + 2 * place_of(fast, fast->finger[fast->fingers - 1].held) : 0;
    for (int64_t k = 0; k < codes; k += 16) __builtin_prefetch(fast->pair + code * codes + k); /* 16 rows a line */
}

/* Wait until a descriptor can be read, a signal comes, or `until_ns` (NONE: without end), and answer a report. */
void fast_wait(Fast *fast, int64_t until_ns) {
    /* Wait for the descriptors and the timer. */
    struct pollfd waited[MOST_WAITED + 1];
    fast->packet_size = fast->frame_size = fast->written = 0;
    for (int i = 0; i < fast->waited; i++) {
        waited[i] = (struct pollfd){.fd = (int)fast->descriptor[i], .events = POLLIN};
        fast->readable[i] = 0;
    }
    waited[fast->waited] = (struct pollfd){.fd = (int)fast->timer, .events = POLLIN};
    if (until_ns != fast->armed_ns) arm(fast, until_ns);
    warm(fast);
    if (poll(waited, (nfds_t)fast->waited + 1, -1) < 0) return;
    if (waited[fast->waited].revents) {
        uint64_t expired;
        fast->armed_ns = read((int)fast->timer, &expired, sizeof expired) == sizeof expired ? NONE : fast->armed_ns;
    }
    for (int i = 0; i < fast->waited; i++) fast->readable[i] = waited[i].revents != 0;
    /* Read the report; the first descriptor is that of the touches. */
    if (!fast->readable[0]) return;
    const ssize_t size = read((int)fast->touch, fast->packet, PACKET_SIZE);
    fast->read_ns = now_ns();
    if (size <= 0) return; /* the loop reads again and handles the error */
    fast->packet_size = size;
    if (!fast->can_answer || fast_answer(fast) != ANSWERED) return;
    /* After a stall there are more reports: nothing stale is sent. */
    if (is_readable(fast->touch)) {
        fast->frame_size = 0;
        return;
    }
    const ssize_t written = write((int)fast->link, fast->frame, (size_t)fast->frame_size);
    fast->written_ns = now_ns();
    fast->written = written < 0 ? 0 : written;
}
