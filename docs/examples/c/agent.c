/* An agent that walks away from where it started, written from docs/protocol.md alone.
 *
 * Build: cc -std=c11 -o agent agent.c -lzmq
 * Usage: ./agent [tcp://127.0.0.1:4097] [session]
 *
 * Observations are read as they lie in memory: this needs a little-endian machine.
 */

#include <inttypes.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>
#include <zmq.h>

enum { HELLO = 64, WELCOME, REFUSE, HEARTBEAT, GOODBYE, ERROR };
enum { INIT = 4, START, STEP, END, CLEANUP, MESSAGE = 10 };

/* After receiving nothing for this long, a peer asks the hub whether it still knows it. */
enum { SILENCE_MS = 1000 };

/* --- Observations and actions: the bodies ------------------------------------------------------- */

struct counts {
    uint32_t ints, doubles, chars, zero;
};

static struct counts counts_of(const uint8_t *body) {
    struct counts counts;
    memcpy(&counts, body, sizeof counts);
    return counts;
}

static double double_at(const uint8_t *body, uint32_t i) {
    double value;
    memcpy(&value, body + 16 + 8 * (size_t)i, sizeof value);
    return value;
}

static int32_t int_at(const uint8_t *body, uint32_t i) {
    int32_t value;
    memcpy(&value, body + 16 + 8 * (size_t)counts_of(body).doubles + 4 * (size_t)i, sizeof value);
    return value;
}

/* --- msgpack: as much of it as headers need ----------------------------------------------------- */

struct bytes {
    uint8_t data[4096];
    size_t size;
};

static void put(struct bytes *to, const void *data, size_t size) {
    memcpy(to->data + to->size, data, size);
    to->size += size;
}

static void put_byte(struct bytes *to, uint8_t byte) { put(to, &byte, 1); }

static void put_array(struct bytes *to, int items) { put_byte(to, 0x90 | items); } /* up to 15 */

static void put_int(struct bytes *to, int64_t value) {
    put_byte(to, 0xd3);
    for (int shift = 56; shift >= 0; shift -= 8) put_byte(to, (uint8_t)(value >> shift));
}

static void put_text(struct bytes *to, const char *text) {
    size_t size = strlen(text);
    put_byte(to, 0xda);
    put_byte(to, (uint8_t)(size >> 8));
    put_byte(to, (uint8_t)size);
    put(to, text, size);
}

/* One item of a header. A number is in both `whole` and `real`; a truth value is 0 or 1. */
struct item {
    int64_t whole;
    double real;
    const char *text;
    size_t size;
};

static uint64_t big_endian(const uint8_t **at, int size) {
    uint64_t value = 0;
    while (size-- > 0) value = value << 8 | *(*at)++;
    return value;
}

static struct item number(int64_t value) { return (struct item){.whole = value, .real = (double)value}; }

static struct item run(const uint8_t **at, size_t size) {
    struct item item = {.text = (const char *)*at, .size = size};
    *at += size;
    return item;
}

/* Take the next item; of an array, its length. The hub is trusted to send what the document says. */
static struct item next(const uint8_t **at) {
    uint8_t tag = *(*at)++;
    if (tag < 0x80) return number(tag);
    if (tag >= 0xe0) return number((int8_t)tag);
    if ((tag & 0xf0) == 0x90) return number(tag & 0x0f);
    if ((tag & 0xe0) == 0xa0) return run(at, tag & 0x1f);
    switch (tag) {
    case 0xc3: return number(1);
    case 0xc4: case 0xd9: return run(at, big_endian(at, 1));
    case 0xc5: case 0xda: return run(at, big_endian(at, 2));
    case 0xcc: case 0xcd: case 0xce: case 0xcf: return number((int64_t)big_endian(at, 1 << (tag - 0xcc)));
    case 0xd0: return number((int8_t)big_endian(at, 1));
    case 0xd1: return number((int16_t)big_endian(at, 2));
    case 0xd2: return number((int32_t)big_endian(at, 4));
    case 0xd3: return number((int64_t)big_endian(at, 8));
    case 0xcb: {
        uint64_t bits = big_endian(at, 8);
        double value;
        memcpy(&value, &bits, sizeof value);
        return (struct item){.whole = (int64_t)value, .real = value};
    }
    default: return number(0); /* nil, false */
    }
}

/* --- The agent ---------------------------------------------------------------------------------- */

static struct {
    int32_t start;
    long episodes;
    double total;
    char seen[128];
} agent;

/* Go up (1) if the first int says that it is not below the start, else down (0). */
static void act(const uint8_t *observation, struct bytes *answer) {
    struct counts counts = counts_of(observation), one_int = {.ints = 1};
    double sum = 0;
    for (uint32_t i = 0; i < counts.doubles; i++) sum += double_at(observation, i);
    snprintf(agent.seen, sizeof agent.seen, "%u ints, %u doubles that sum to %g, %u chars", counts.ints,
             counts.doubles, sum, counts.chars);
    int32_t action = int_at(observation, 0) >= agent.start;
    put(answer, &one_int, sizeof one_int);
    put(answer, &action, sizeof action);
}

/* Write the body of the answer to a call; return 1 if it has one, 0 if not, -1 if the call is unknown. */
static int answer(int64_t kind, double reward, const uint8_t *body, struct bytes *answer_body) {
    switch (kind) {
    case INIT:
        memset(&agent, 0, sizeof agent);
        strcpy(agent.seen, "0 ints, 0 doubles that sum to 0, 0 chars");
        return 0;
    case START:
        agent.start = int_at(body, 0);
        act(body, answer_body);
        return 1;
    case STEP:
        agent.total += reward;
        act(body, answer_body);
        return 1;
    case END:
        agent.total += reward;
        agent.episodes += 1;
        return 0;
    case CLEANUP:
        return 0;
    case MESSAGE:
        answer_body->size = (size_t)snprintf((char *)answer_body->data, sizeof answer_body->data,
                                             "%ld episodes, %g in all; last seen: %s", agent.episodes,
                                             agent.total, agent.seen);
        return 1;
    default:
        return -1;
    }
}

/* --- The connection ----------------------------------------------------------------------------- */

static struct bytes hello_of(const char *session) {
    uint8_t instance[16];
    FILE *random = fopen("/dev/urandom", "rb");
    if (random == NULL || fread(instance, sizeof instance, 1, random) != 1) exit(1);
    fclose(random);
    struct bytes hello = {.size = 0};
    put_array(&hello, 9);
    put_int(&hello, HELLO);
    put_text(&hello, session);
    put_int(&hello, 0);
    put_array(&hello, 1);
    put_int(&hello, 1);
    put_text(&hello, "agent");
    put_byte(&hello, 0xc4);
    put_byte(&hello, sizeof instance);
    put(&hello, instance, sizeof instance);
    put_text(&hello, "walker");
    put_text(&hello, "C, libzmq");
    put_array(&hello, 0);
    return hello;
}

static struct bytes heartbeat_of(const char *session) {
    struct bytes heartbeat = {.size = 0};
    put_array(&heartbeat, 3);
    put_int(&heartbeat, HEARTBEAT);
    put_text(&heartbeat, session);
    put_int(&heartbeat, 0);
    return heartbeat;
}

/* Return a socket that reports new connections to the hub: libzmq reconnects without saying so. */
static void *monitor_of(void *context, void *socket) {
    void *monitor = zmq_socket(context, ZMQ_PAIR);
    zmq_socket_monitor(socket, "inproc://monitor", ZMQ_EVENT_HANDSHAKE_SUCCEEDED | ZMQ_EVENT_DISCONNECTED);
    zmq_connect(monitor, "inproc://monitor");
    return monitor;
}

/* Return the next event of a monitor; the frame after it is an address. */
static uint16_t next_event(void *monitor) {
    uint8_t event[6], address[256];
    zmq_recv(monitor, event, sizeof event, 0);
    zmq_recv(monitor, address, sizeof address, 0);
    uint16_t kind;
    memcpy(&kind, event, sizeof kind);
    return kind;
}

static int same(zmq_msg_t *one, zmq_msg_t *other) {
    size_t size = zmq_msg_size(one);
    return size == zmq_msg_size(other) && (size == 0 || memcmp(zmq_msg_data(one), zmq_msg_data(other), size) == 0);
}

/* Everything that is sent again if it is asked for again. */
struct reply {
    struct bytes header, body;
    int has_body;
};

static void send_reply(void *socket, const struct reply *reply) {
    zmq_send(socket, reply->header.data, reply->header.size, reply->has_body ? ZMQ_SNDMORE : 0);
    if (reply->has_body) zmq_send(socket, reply->body.data, reply->body.size, 0);
}

static void make_reply(struct reply *reply, const char *session, int64_t kind, int64_t seq, double reward,
                       const uint8_t *body) {
    reply->header.size = reply->body.size = 0;
    int has_body = answer(kind, reward, body, &reply->body);
    int unknown = has_body < 0;
    reply->has_body = has_body > 0;
    put_array(&reply->header, unknown ? 5 : 3);
    put_int(&reply->header, unknown ? ERROR : kind);
    put_text(&reply->header, session);
    put_int(&reply->header, seq);
    if (unknown) {
        put_text(&reply->header, "unknown-kind");
        put_text(&reply->header, "this agent does not know that call");
    }
}

int main(int argc, char **argv) {
    const char *hub = argc > 1 ? argv[1] : "tcp://127.0.0.1:4097";
    const char *session = argc > 2 ? argv[2] : "default";
    const int silence = SILENCE_MS;
    static struct reply last;
    struct bytes hello = hello_of(session), heartbeat = heartbeat_of(session);
    int64_t last_seq = 0;
    zmq_msg_t last_header, last_body; /* of the call that was answered last */
    int welcomed = 0;
    zmq_msg_init(&last_header);
    zmq_msg_init(&last_body);

    void *context = zmq_ctx_new();
    void *socket = zmq_socket(context, ZMQ_DEALER);
    zmq_setsockopt(socket, ZMQ_HEARTBEAT_IVL, &silence, sizeof silence);
    zmq_setsockopt(socket, ZMQ_LINGER, &silence, sizeof silence);
    void *monitor = monitor_of(context, socket);
    if (zmq_connect(socket, hub) != 0) {
        fprintf(stderr, "%s is not an address of a hub: %s\n", hub, zmq_strerror(zmq_errno()));
        return 1;
    }

    for (;;) {
        zmq_pollitem_t polled[] = {{.socket = monitor, .events = ZMQ_POLLIN},
                                   {.socket = socket, .events = ZMQ_POLLIN}};
        if (zmq_poll(polled, 2, SILENCE_MS) <= 0) {
            if (welcomed) zmq_send(socket, heartbeat.data, heartbeat.size, 0);
            continue;
        }
        if (polled[0].revents & ZMQ_POLLIN) {
            welcomed = 0;
            if (next_event(monitor) == ZMQ_EVENT_HANDSHAKE_SUCCEEDED) zmq_send(socket, hello.data, hello.size, 0);
            continue;
        }
        zmq_msg_t header, body;
        zmq_msg_init(&header);
        zmq_msg_init(&body);
        zmq_msg_recv(&header, socket, 0);
        if (zmq_msg_more(&header)) zmq_msg_recv(&body, socket, 0);

        const uint8_t *at = zmq_msg_data(&header);
        int64_t scalars = next(&at).whole - 3;
        int64_t kind = next(&at).whole;
        next(&at); /* the session */
        int64_t seq = next(&at).whole;
        struct item first = {0}, second = {0};
        if (scalars > 0) first = next(&at);
        if (scalars > 1) second = next(&at);

        if (kind == WELCOME) {
            welcomed = 1;
            if (!second.whole) last_seq = 0;
        } else if (kind == REFUSE || kind == GOODBYE) {
            if (kind == REFUSE) fprintf(stderr, "refused: %.*s\n", (int)second.size, second.text);
            return kind == REFUSE;
        } else if (kind == ERROR) {
            if (first.size != strlen("unknown-peer") || memcmp(first.text, "unknown-peer", first.size) != 0)
                fprintf(stderr, "the hub says: %.*s\n", (int)second.size, second.text);
            else if (welcomed) {
                welcomed = 0;
                zmq_send(socket, hello.data, hello.size, 0);
            }
        } else if (kind != HEARTBEAT && same(&header, &last_header) && same(&body, &last_body)) {
            send_reply(socket, &last);
        } else if (kind != HEARTBEAT && seq > last_seq) {
            make_reply(&last, session, kind, seq, first.real, zmq_msg_data(&body));
            last_seq = seq;
            send_reply(socket, &last);
            zmq_msg_move(&last_header, &header);
            zmq_msg_move(&last_body, &body);
        }
        zmq_msg_close(&header);
        zmq_msg_close(&body);
    }
}
