/* A floor under the engine: wakes up for a report, decodes nothing, writes as many bytes as a command has.
 *
 * echo_engine TOUCH LINK EVERY SIZE SAMPLES PRIORITY PROCESSOR LOCK
 *
 * TOUCH is a descriptor that gives a packet a report, led by two int64: when it was due and when it was sent (ns of
 * CLOCK_MONOTONIC); LINK takes the answers. Each EVERYth report is answered by SIZE bytes. At the end of TOUCH the file SAMPLES gets
 * four int64 an answer: due, sent, read, written. PRIORITY above 0 is SCHED_FIFO, PROCESSOR from 0 is the only one it
 * runs on, LOCK other than 0 keeps its pages in memory. A first answer says that it is ready. Exit status 2: a step was
 * refused.
 */
#define _GNU_SOURCE
#include <poll.h>
#include <sched.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <time.h>
#include <unistd.h>

enum { MOST_SIZE = 1024, MOST_SAMPLES = 1 << 17, REPORT_SIZE = 4096 };

static int64_t samples[MOST_SAMPLES][4];

static int64_t now_ns(void) {
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return (int64_t)now.tv_sec * 1000000000 + now.tv_nsec;
}

static int prepare(int priority, int processor, int lock) {
    cpu_set_t set;
    struct sched_param parameter = {.sched_priority = priority};
    CPU_ZERO(&set);
    CPU_SET(processor < 0 ? 0 : processor, &set);
    memset(samples, 1, sizeof samples); /* every page is there before the first report */
    if (lock && mlockall(MCL_CURRENT | MCL_FUTURE) != 0) return 0;
    if (processor >= 0 && sched_setaffinity(0, sizeof set, &set) != 0) return 0;
    return priority <= 0 || sched_setscheduler(0, SCHED_FIFO, &parameter) == 0;
}

int main(int count, char **words) {
    static unsigned char report[REPORT_SIZE], frame[MOST_SIZE];
    if (count != 9) return 1;
    const int touch = atoi(words[1]), link = atoi(words[2]), every = atoi(words[3]), size = atoi(words[4]);
    if (size < 1 || size > MOST_SIZE) return 1;
    if (!prepare(atoi(words[6]), atoi(words[7]), atoi(words[8]))) return 2;
    memset(frame, 5, (size_t)size - 1); /* no zero but the last byte, as on the wire */
    if (write(link, frame, (size_t)size) != size) return 1;
    int64_t reports = 0, answers = 0;
    for (;;) {
        struct pollfd waited = {.fd = touch, .events = POLLIN};
        poll(&waited, 1, -1);
        const ssize_t taken = read(touch, report, sizeof report);
        const int64_t read_ns = now_ns();
        if (taken <= 0) break;
        if (reports++ % every != 0 || answers == MOST_SAMPLES) continue;
        if (write(link, frame, (size_t)size) != size) break;
        memcpy(samples[answers], report, 16);
        samples[answers][2] = read_ns;
        samples[answers++][3] = now_ns();
    }
    FILE *file = fopen(words[5], "wb");
    if (file == NULL) return 1;
    const size_t written = fwrite(samples, sizeof samples[0], (size_t)answers, file);
    return fclose(file) == 0 && written == (size_t)answers ? 0 : 1;
}
