/* Client of a foretorque board in one file, and an example loop: read drives, sample, torque, drives, log.
 *
 *     cc -std=c11 -O2 -o client foretorque.c -lm && ./client PORT [SECONDS [LOG [Q1,Q2,...]]]
 *
 * POSIX; the messages are those of docs/protocol.md. Put your drives in the place of drives_read and drives_command.
 * The torque of a board adds to the position loop of the drives, which must hold the arm alone. */
#define _DEFAULT_SOURCE
#include <errno.h>
#include <fcntl.h>
#include <math.h>
#include <poll.h>
#include <signal.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <termios.h>
#include <time.h>
#include <unistd.h>

#ifndef B2000000 /* Not every system has the rate of the link; a pseudo-terminal has none. */
#define B2000000 B38400
#endif

enum { VERSION = 4, MOST_JOINTS = 8, MOST_BYTES = 300, PERIOD_US = 1000 };
enum { HELLO = 0, SAMPLE = 1, CONFIGURE = 3, ARM = 10, DISARM = 11 }; /* host to board */
enum { TORQUE = 1, FULL_TORQUE = 2, ACK = 4, NACK = 5, EXCITED = 11 }; /* board to host */
enum { DISARMED = 0, ARMED = 1, RAMP_DOWN = 2 };                      /* safety states */
enum { UNKNOWN = -128 }; /* temperature of a motor without a sensor, degrees C */

static const double OPENING_S = 2.0; /* wait for an answer while no torque may flow */
/* Silence of the board that ends the torque, as that of the host does on the board (docs/safety.md). */
static const double SILENCE_S = 0.05;
/* Wait for one torque, after which the next sample follows: a board holds its torque that long. */
static const double REPLY_S = 0.01;
/* Share of the time that late periods may leave out. */
static const double LEFT_OUT = 0.05;

struct board {
    int port;
    int joints;
    char arm[32];
    uint8_t configuration[8]; /* period, pacing, reply mode, closing time of the brakes */
    uint16_t sequence;
    uint8_t period;
    uint8_t waiting[MOST_BYTES]; /* bytes of a frame that has not ended */
    size_t count;
    size_t length; /* of the content of the last answer */
    int armed;       /* torque may flow */
    double answered; /* time of the last answer, s */
    long lost;       /* samples without a reply */
    /* Of the last sample. */
    uint32_t tick;
    uint16_t flags;
    uint8_t safety, reason;
};

/* Motion that the arm shall have in the next period, and measurement. */
struct sample {
    double q[MOST_JOINTS], qd[MOST_JOINTS], qdd[MOST_JOINTS];
    double measured_q[MOST_JOINTS], measured_tau[MOST_JOINTS];
    int8_t celsius[MOST_JOINTS]; /* of the motors, or UNKNOWN */
};

static void fail(const char *what) {
    fprintf(stderr, "error: %s\n", what);
    exit(1);
}

/* Reports a file or port that cannot be used. */
static void fail_at(const char *name) {
    fprintf(stderr, "error: %s: %s\n", name, strerror(errno));
    exit(1);
}

/* Reports a mistake in the arguments. */
static void refuse(const char *what, const char *argument) {
    fprintf(stderr, "error: %s: %s\n", argument, what);
    exit(2);
}

static double seconds(void) {
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return (double)now.tv_sec + 1e-9 * (double)now.tv_nsec;
}

static uint32_t crc32(const uint8_t *bytes, size_t count) {
    uint32_t crc = 0xffffffffu;
    for (size_t k = 0; k < count; k++) {
        crc ^= bytes[k];
        for (int bit = 0; bit < 8; bit++) crc = (crc >> 1) ^ (0xedb88320u & (0u - (crc & 1u)));
    }
    return ~crc;
}

static uint32_t little(const uint8_t *bytes, int count) {
    uint32_t value = 0;
    for (int k = 0; k < count; k++) value |= (uint32_t)bytes[k] << (8 * k);
    return value;
}

static uint8_t *put(uint8_t *to, uint32_t value, int count) {
    for (int k = 0; k < count; k++) *to++ = (uint8_t)(value >> (8 * k));
    return to;
}

/* Integers of `size` bytes in units of 2^-bits, saturated; NaN is the most negative one. */
static uint8_t *put_scaled(uint8_t *to, const double *values, int joints, int size, int bits) {
    double most = ldexp(1.0, 8 * size - 1) - 1.0;
    for (int j = 0; j < joints; j++) {
        double code = floor(ldexp(values[j], bits) + 0.5);
        code = isnan(code) ? -most - 1.0 : fmax(-most, fmin(most, code));
        to = put(to, (uint32_t)(int32_t)code, size);
    }
    return to;
}

/* Sends a message of `count` bytes under the next number: version, number, message, checksum, in COBS. */
static void post(struct board *board, const uint8_t *message, size_t count) {
    uint8_t body[MOST_BYTES], frame[MOST_BYTES + 4];
    board->sequence = (uint16_t)(board->sequence % 65535 + 1);
    uint8_t *end = put(put(body, VERSION, 1), board->sequence, 2);
    memcpy(end, message, count);
    end += count;
    end = put(end, crc32(body, (size_t)(end - body)), 4);
    size_t code = 0, length = 1; /* frames are shorter than 254 bytes: no block is full */
    for (uint8_t *byte = body; byte < end; byte++) {
        if (*byte) {
            frame[length++] = *byte;
        } else {
            frame[code] = (uint8_t)(length - code);
            code = length++;
        }
    }
    frame[code] = (uint8_t)(length - code);
    frame[length++] = 0;
    for (size_t sent = 0; sent < length;) {
        ssize_t written = write(board->port, frame + sent, length - sent);
        if (written < 0 && errno != EINTR) fail("the port is gone");
        if (written > 0) sent += (size_t)written;
    }
}

/* Removes COBS in place and checks the frame; the length of its body without checksum, 0 for a damaged one. */
static size_t unpack(uint8_t *frame, size_t count) {
    size_t length = 0;
    for (size_t place = 0; place < count;) {
        size_t code = frame[place];
        if (place + code > count) return 0;
        memmove(frame + length, frame + place + 1, code - 1);
        length += code - 1;
        place += code;
        if (code < 255 && place < count) frame[length++] = 0;
    }
    if (length < 8 || crc32(frame, length - 4) != little(frame + length - 4, 4)) return 0;
    if (frame[0] != VERSION) fail("the board speaks another version of the protocol");
    return length - 4;
}

/* No answer has come for so long that the torque must end. */
static int silent(const struct board *board) { return seconds() - board->answered >= SILENCE_S; }

/* Waits for the answer with the tag `wanted` to the last message; its content.
   While torque may flow, it waits `wait_s` at most, and returns NULL where the answer does not come. */
static const uint8_t *answer(struct board *board, uint8_t wanted, double wait_s) {
    static uint8_t frame[MOST_BYTES];
    double now = seconds();
    double deadline = board->armed ? fmin(now + wait_s, board->answered + SILENCE_S) : now + OPENING_S;
    for (int late = 0;;) {
        uint8_t byte;
        struct pollfd port = {.fd = board->port, .events = POLLIN};
        double left_s = deadline - seconds();
        /* What has come by the deadline counts, however late this program looks: a port keeps 4096 bytes. */
        int ready = late > 4096 ? 0 : poll(&port, 1, (int)ceil(1e3 * fmax(left_s, 0.0)));
        if (ready < 0 && errno == EINTR) continue;
        if (ready < 0) fail("the port is gone");
        if (ready == 0 && board->armed) return NULL;
        if (ready == 0) fail("the board does not answer");
        late += left_s <= 0.0;
        ssize_t received = read(board->port, &byte, 1);
        if (received < 0 && errno == EINTR) continue;
        if (received <= 0) fail("the port is gone");
        if (byte) {
            if (board->count < sizeof board->waiting) board->waiting[board->count++] = byte;
            continue;
        }
        memcpy(frame, board->waiting, board->count);
        size_t length = unpack(frame, board->count);
        board->count = 0;
        if (length == 0) continue; /* damaged */
        if (little(frame + 1, 2) != board->sequence) { /* late, or telemetry */
            /* A slow link needs more than one reply's time. */
            if (frame[3] == wanted && board->armed) deadline = board->answered + SILENCE_S;
            continue;
        }
        if (frame[3] == NACK) {
            fprintf(stderr, "error: the board refused: reason %d, %d (docs/protocol.md, Nack reasons)\n", frame[4],
                    length > 5 ? frame[5] : 0);
            exit(1);
        }
        if (wanted == TORQUE && (frame[3] == FULL_TORQUE || frame[3] == EXCITED))
            fail("the board answers in full, or plays or holds an excitation: reset it");
        if (frame[3] == wanted) {
            board->answered = seconds();
            board->length = length - 4;
            return frame + 4;
        }
    }
}

/* Opens the port and greets the board, which disarms it. */
static void board_open(struct board *board, const char *port) {
    memset(board, 0, sizeof *board);
    board->port = open(port, O_RDWR | O_NOCTTY);
    struct termios settings;
    if (board->port < 0 || tcgetattr(board->port, &settings)) fail_at(port);
    cfmakeraw(&settings);
    cfsetspeed(&settings, B2000000);
    settings.c_cflag = (settings.c_cflag | CLOCAL | CREAD) & ~(tcflag_t)CSTOPB; /* three wires, one stop bit */
#ifdef CRTSCTS
    settings.c_cflag &= ~(tcflag_t)CRTSCTS;
#endif
    tcsetattr(board->port, TCSANOW, &settings);
    tcflush(board->port, TCIOFLUSH);
    /* It ends a frame that a host before has begun. */
    uint8_t end = 0, hello = HELLO;
    if (write(board->port, &end, 1) != 1) fail("the port is gone");
    post(board, &hello, 1);
    const uint8_t *content = answer(board, HELLO, OPENING_S), *last = content + board->length;
    /* It has two names with their lengths before them; the configuration is behind both. */
    if (content + 8 + content[4] > last || content + 23 + content[4] + content[7 + content[4]] > last)
        fail("the hello of the board is too short");
    size_t length = content[4] < sizeof board->arm - 1 ? content[4] : sizeof board->arm - 1;
    memcpy(board->arm, content + 5, length);
    board->joints = content[5 + content[4]];
    if (board->joints < 1 || board->joints > MOST_JOINTS) fail("the board drives too many joints");
    content += 7 + content[4];
    content += 8 + content[0]; /* version, capabilities, counter */
    memcpy(board->configuration, content, sizeof board->configuration);
}

/* Sets the period of the samples, and short replies, where they differ. Only while disarmed and with learning off. */
static void board_configure(struct board *board, uint32_t period_us) {
    if (little(board->configuration, 4) == period_us && board->configuration[5] == 0) return;
    uint8_t message[9] = {CONFIGURE};
    put(board->configuration, period_us, 4);
    board->configuration[5] = 0;
    memcpy(message + 1, board->configuration, sizeof board->configuration);
    post(board, message, sizeof message);
    answer(board, ACK, OPENING_S);
}

/* Sends an order; 0 where the board is silent. */
static int board_command(struct board *board, uint8_t tag) {
    post(board, &tag, 1);
    return answer(board, ACK, SILENCE_S) != NULL;
}

/* Runs a tick; the torques go into `torque`, N·m. 0 for a reply that is lost while torque may flow. */
static int board_sample(struct board *board, const struct sample *sample, float *torque) {
    uint8_t message[MOST_BYTES];
    int n = board->joints;
    uint8_t *end = put(message, SAMPLE, 1);
    end = put(end, 1u | (uint32_t)board->period << 3, 1); /* measured; number of the period */
    end = put(end, (uint8_t)sample->celsius[board->period % n], 1); /* one motor's in turn */
    board->period = (uint8_t)((board->period + 1) % 32);
    end = put_scaled(end, sample->q, n, 3, 20);
    end = put_scaled(end, sample->qd, n, 3, 18);
    end = put_scaled(end, sample->qdd, n, 2, 9);
    end = put_scaled(end, sample->measured_q, n, 3, 20);
    end = put_scaled(end, sample->measured_tau, n, 3, 14);
    post(board, message, (size_t)(end - message));
    /* The timer of a board may pace the reply. */
    const uint8_t *content = answer(board, TORQUE, fmax(REPLY_S, 1.1e-6 * little(board->configuration, 4)));
    if (!content) {
        board->lost++;
        return 0;
    }
    if (board->length < 8 + 4 * (size_t)n) fail("the torque of the board is too short");
    board->tick = little(content, 4);
    board->flags = (uint16_t)little(content + 4, 2);
    board->safety = content[6];
    board->reason = content[7];
    for (int j = 0; j < n; j++) {
        uint32_t bits = little(content + 8 + 4 * j, 4);
        memcpy(&torque[j], &bits, sizeof bits);
    }
    return 1;
}

/* Simulated drives that follow at once. Yours send q, qd and the torque to the bus; they read q,
   torque and temperature from it. */
static double drive_q[MOST_JOINTS], drive_tau[MOST_JOINTS];

static void drives_read(struct sample *sample) {
    memcpy(sample->measured_q, drive_q, sizeof drive_q);
    memcpy(sample->measured_tau, drive_tau, sizeof drive_tau);
    memset(sample->celsius, 25, sizeof sample->celsius);
}

static void drives_command(const struct sample *desired, const float *torque, int joints) {
    for (int j = 0; j < joints; j++) {
        drive_q[j] = desired->q[j];
        drive_tau[j] = torque[j];
    }
}

static volatile sig_atomic_t interrupted;

static void interrupt(int number) {
    (void)number;
    interrupted = 1;
}

/* The place of the last command, which the drives hold without torque whatever ends the program. */
static struct sample hold;
static int held_joints;

static void let_go(void) {
    const float zero[MOST_JOINTS] = {0.0f};
    drives_command(&hold, zero, held_joints);
}

/* Lets the torque go to zero while the drives hold the position; they get every torque on the way, then zero.
   Where the board is silent, they get zero at once, and the program ends. */
static void disarm(struct board *board) {
    float torque[MOST_JOINTS];
    int answers = !silent(board);
    if (!answers) let_go();
    answers = board_command(board, DISARM) && answers;
    while (answers) {
        drives_read(&hold);
        if (!board_sample(board, &hold, torque)) {
            answers = !silent(board);
            continue;
        }
        drives_command(&hold, torque, board->joints);
        if (board->safety != ARMED && board->safety != RAMP_DOWN) break;
    }
    let_go();
    if (!answers) {
        fprintf(stderr, "error: the board has been silent for %.0f ms\n", 1e3 * SILENCE_S);
        exit(1);
    }
}

/* A slow swing of every joint that begins at rest. */
static void motion(double t_s, const double *start, int joints, struct sample *sample) {
    const double size = 0.1, omega = 2.0;
    for (int j = 0; j < joints; j++) {
        sample->q[j] = start[j] + size * (1.0 - cos(omega * t_s));
        sample->qd[j] = size * omega * sin(omega * t_s);
        sample->qdd[j] = size * omega * omega * cos(omega * t_s);
    }
}

static void columns(FILE *log, const char *name, const char *unit, int joints) {
    for (int j = 1; j <= joints; j++) fprintf(log, ",%s%d_%s", name, j, unit);
}

static void row(FILE *log, const double *values, int joints) {
    for (int j = 0; j < joints; j++) fprintf(log, ",%.9g", values[j]);
}

int main(int count, char **arguments) {
    if (count < 2 || count > 5) refuse("PORT [SECONDS [LOG [Q1,Q2,...]]]", "arguments");
    char *end = NULL;
    const double period_s = 1e-6 * PERIOD_US;
    double duration_s = count > 2 ? strtod(arguments[2], &end) : 5.0;
    if ((end && *end) || !(duration_s >= period_s && duration_s < 1e6)) refuse("not a duration, s", arguments[2]);
    double start[MOST_JOINTS] = {0.0};
    int given = 0;
    for (char *pose = count > 4 ? arguments[4] : NULL; pose; given++) {
        double angle = strtod(pose, &end);
        if (end == pose || (*end && *end != ',') || !isfinite(angle)) refuse("not angles, rad", arguments[4]);
        if (given < MOST_JOINTS) start[given] = angle;
        pose = *end ? end + 1 : NULL;
    }
    struct board board;
    board_open(&board, arguments[1]);
    int n = board.joints;
    printf("%s, %d joints\n", board.arm, n);
    if (given && given != n) refuse("not one angle for each joint", arguments[4]);
    board_configure(&board, PERIOD_US);
    const char *name = count > 3 ? arguments[3] : "log.csv";
    FILE *log = fopen(name, "a");
    if (!log) fail_at(name);
    memcpy(drive_q, start, sizeof start);

    struct sample sample = {0};
    float torque[MOST_JOINTS];
    memcpy(sample.q, start, sizeof start);
    drives_read(&sample);
    for (int k = 0; k < 20; k++) board_sample(&board, &sample, torque); /* the board sees where the arm stands */
    signal(SIGINT, interrupt);
    signal(SIGTERM, interrupt);
    signal(SIGHUP, interrupt);
    signal(SIGQUIT, interrupt);
    signal(SIGTSTP, SIG_IGN); /* a program that stands still would leave the torque at the drives */
    hold = sample;
    held_joints = n;
    atexit(let_go);
    board.armed = 1;
    if (!board_command(&board, ARM)) disarm(&board);

    log = freopen(name, "w", log); /* A log from before stays where the board refuses. */
    if (!log) fail_at(name);
    fprintf(log, "t_s");
    columns(log, "q", "rad", n);
    columns(log, "qd", "rad_s", n);
    columns(log, "qdd", "rad_s2", n);
    columns(log, "tau", "nm", n);
    columns(log, "feed_forward", "nm", n);
    fprintf(log, ",flags\n");
    double begin = seconds(), left_out_s = 0.0;
    long ticks = lround(duration_s / period_s);
    for (long tick = 0; tick < ticks && !interrupted; tick++) {
        double path_s = (double)tick * period_s, t_s = path_s + left_out_s, late_s = seconds() - begin - t_s;
        if (late_s < 0.0) usleep((useconds_t)(-1e6 * late_s));
        if (late_s >= period_s) {
            /* Missed periods are left out: the motion goes on from where it is, and samples never come in a burst. */
            t_s += late_s;
            left_out_s += late_s;
            board.period = (uint8_t)((board.period + (long)(late_s / period_s)) % 32);
            if (left_out_s > LEFT_OUT * duration_s) {
                disarm(&board);
                fprintf(stderr, "error: link or program are too slow: %.3f of %.3f s were left out\n", left_out_s, t_s);
                return 1;
            }
        }
        drives_read(&sample);
        motion(path_s, start, n, &sample);
        if (!board_sample(&board, &sample, torque)) {
            if (silent(&board)) disarm(&board);
            continue; /* the drives go on with their last command */
        }
        if (board.safety != ARMED) {
            fprintf(stderr, "error: the board ended the torque: state %d, reason %d (docs/safety.md)\n", board.safety,
                    board.reason);
            disarm(&board);
            return 1;
        }
        drives_command(&sample, torque, n);
        memcpy(hold.q, sample.q, sizeof hold.q);
        /* The torque acts in the next period, the measurement is from before it. */
        fprintf(log, "%.9g", t_s);
        row(log, sample.measured_q, n);
        row(log, sample.qd, n);
        row(log, sample.qdd, n);
        row(log, sample.measured_tau, n);
        for (int j = 0; j < n; j++) fprintf(log, ",%.9g", (double)torque[j]);
        fprintf(log, ",%d\n", board.flags);
    }

    disarm(&board);
    if (interrupted) fail("interrupted");
    int damaged = ferror(log);
    if (fclose(log) || damaged) fail_at(name);
    printf("%ld ticks, %ld without a reply\n", ticks, board.lost);
    return 0;
}
