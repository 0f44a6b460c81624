/* The part of docs/protocol.md that every agent needs, over libzmq, written from that page alone.
 *
 * A program defines `answer` and calls `serve`. Bodies are read as they lie in memory: this needs a
 * little-endian machine.
 */

#include <inttypes.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <zmq.h>

enum { HELLO = 64, WELCOME, REFUSE, HEARTBEAT, GOODBYE, ERROR, NOTICE };
enum { INIT = 4, START, STEP, END, CLEANUP, MESSAGE = 10, SEED = 80, SAVE, LOAD };

enum { MAX_HEADER = 4096, MAX_BODY = 16777216 };

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

/* Return whether a body of this size is one observation or action, as long as its counts say. */
static int is_abstract(const uint8_t *body, size_t size) {
    if (size < sizeof(struct counts)) return 0;
    struct counts counts = counts_of(body);
    return counts.zero == 0 && size == 16 + 8 * (size_t)counts.doubles + 4 * (size_t)counts.ints + counts.chars;
}

/* --- Bytes to send ------------------------------------------------------------------------------ */

struct bytes {
    uint8_t *data;
    size_t size, room;
};

static void put(struct bytes *to, const void *data, size_t size) {
    if (to->size + size > to->room) {
        to->room = 2 * (to->size + size);
        to->data = realloc(to->data, to->room);
        if (to->data == NULL) exit(1);
    }
    if (size > 0) memcpy(to->data + to->size, data, size);
    to->size += size;
}

/* --- msgpack: as much of it as headers need ----------------------------------------------------- */

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

/* What is left of a header; `broken` once it has turned out to be none. */
struct reader {
    const uint8_t *at, *end;
    int broken;
};

/* One item of a header. A number is in both `whole` and `real`; a truth value is 0 or 1. */
struct item {
    int64_t whole;
    double real;
    const char *text;
    size_t size;
};

static uint64_t big_endian(struct reader *from, int size) {
    uint64_t value = 0;
    if (from->end - from->at < size) from->broken = 1;
    while (!from->broken && size-- > 0) value = value << 8 | *from->at++;
    return value;
}

static struct item number(int64_t value) { return (struct item){.whole = value, .real = (double)value}; }

static struct item real(double value) { return (struct item){.real = value}; }

static struct item run(struct reader *from, uint64_t size) {
    if ((uint64_t)(from->end - from->at) < size) from->broken = 1;
    if (from->broken) return number(0);
    struct item item = {.text = (const char *)from->at, .size = size};
    from->at += size;
    return item;
}

/* Take the next item; of an array, its length. */
static struct item next(struct reader *from) {
    uint8_t tag = (uint8_t)big_endian(from, 1);
    if (from->broken) return number(0);
    if (tag < 0x80) return number(tag);
    if (tag >= 0xe0) return number((int8_t)tag);
    if ((tag & 0xf0) == 0x90) return number(tag & 0x0f);
    if ((tag & 0xe0) == 0xa0) return run(from, tag & 0x1f);
    switch (tag) {
    case 0xc0: case 0xc2: return number(0);
    case 0xc3: return number(1);
    case 0xc4: case 0xd9: return run(from, big_endian(from, 1));
    case 0xc5: case 0xda: return run(from, big_endian(from, 2));
    case 0xc6: case 0xdb: return run(from, big_endian(from, 4));
    case 0xcc: case 0xcd: case 0xce: case 0xcf: return number((int64_t)big_endian(from, 1 << (tag - 0xcc)));
    case 0xd0: return number((int8_t)big_endian(from, 1));
    case 0xd1: return number((int16_t)big_endian(from, 2));
    case 0xd2: return number((int32_t)big_endian(from, 4));
    case 0xd3: return number((int64_t)big_endian(from, 8));
    case 0xdc: return number((int64_t)big_endian(from, 2));
    case 0xdd: return number((int64_t)big_endian(from, 4));
    case 0xca: {
        uint32_t bits = (uint32_t)big_endian(from, 4);
        float value;
        memcpy(&value, &bits, sizeof value);
        return real(value);
    }
    case 0xcb: {
        uint64_t bits = big_endian(from, 8);
        double value;
        memcpy(&value, &bits, sizeof value);
        return real(value);
    }
    default: from->broken = 1; return number(0);
    }
}

/* --- What the program brings -------------------------------------------------------------------- */

struct call {
    int64_t kind, seed;
    double reward;
    const uint8_t *body;
    size_t size;
};

enum answered { WITHOUT_BODY, WITH_BODY, UNKNOWN, FAILED };

/* Carry out a call and write the body of its answer; if it failed, the text of the failure. */
static enum answered answer(const struct call *call, struct bytes *body);

/* --- The connection ----------------------------------------------------------------------------- */

/* Everything that is sent again if it is asked for again. */
struct reply {
    struct bytes header, body;
    int has_body;
};

struct peer {
    void *socket, *monitor;
    struct bytes hello, heartbeat;
    const char *session;
    int welcomed;
    long silence_ms;
    size_t max_body;
};

static struct bytes hello_of(const char *session, const char *name, const char *const *capabilities) {
    uint8_t instance[16];
    FILE *random = fopen("/dev/urandom", "rb");
    if (random == NULL || fread(instance, sizeof instance, 1, random) != 1) exit(1);
    fclose(random);
    int offered = 0;
    while (capabilities[offered] != NULL) offered++;
    struct bytes hello = {0};
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
    put_text(&hello, name);
    put_text(&hello, "C, libzmq");
    put_array(&hello, offered);
    for (int i = 0; i < offered; i++) put_text(&hello, capabilities[i]);
    return hello;
}

static struct bytes heartbeat_of(const char *session) {
    struct bytes heartbeat = {0};
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

static void greet(struct peer *peer) {
    peer->welcomed = 0;
    zmq_send(peer->socket, peer->hello.data, peer->hello.size, 0);
}

static int same(zmq_msg_t *one, zmq_msg_t *other) {
    size_t size = zmq_msg_size(one);
    return size == zmq_msg_size(other) && (size == 0 || memcmp(zmq_msg_data(one), zmq_msg_data(other), size) == 0);
}

static void send_reply(void *socket, const struct reply *reply) {
    zmq_send(socket, reply->header.data, reply->header.size, reply->has_body ? ZMQ_SNDMORE : 0);
    if (reply->has_body) zmq_send(socket, reply->body.data, reply->body.size, 0);
}

static void make_reply(struct reply *reply, const struct peer *peer, int64_t seq, const struct call *call) {
    reply->header.size = reply->body.size = 0;
    enum answered answered = answer(call, &reply->body);
    const char *code = "exception", *text = "the answer is larger than the hub allows";
    int failed = answered == UNKNOWN || answered == FAILED || reply->body.size > peer->max_body;
    if (answered == UNKNOWN) {
        code = "unknown-kind";
        text = "this agent does not know that call";
    } else if (answered == FAILED) {
        put_byte(&reply->body, 0);
        text = (const char *)reply->body.data;
    }
    reply->has_body = !failed && answered == WITH_BODY;
    put_array(&reply->header, failed ? 5 : 3);
    put_int(&reply->header, failed ? ERROR : call->kind);
    put_text(&reply->header, peer->session);
    put_int(&reply->header, seq);
    if (failed) {
        put_text(&reply->header, code);
        put_text(&reply->header, text);
    }
}

/* Return an option of the program: an argument, else a variable, else what it is by default. */
static const char *option(int argc, char **argv, int at, const char *variable, const char *otherwise) {
    const char *set = getenv(variable);
    return argc > at ? argv[at] : set != NULL && *set != 0 ? set : otherwise;
}

/* Report that the hub sent no message of the protocol; it cannot be trusted any further. */
static int malformed(void) {
    fprintf(stderr, "the hub sent something malformed\n");
    return 1;
}

/* Answer the hub's calls until it says goodbye; return the exit code. Arguments: [hub] [session]. */
static int serve(int argc, char **argv, const char *name, const char *const *capabilities) {
    static struct reply last;
    const char *hub = option(argc, argv, 1, "GLUE_HUB", "tcp://127.0.0.1:4097");
    struct peer peer = {.session = option(argc, argv, 2, "GLUE_SESSION", "default"), .max_body = MAX_BODY};
    const int linger = 1000;
    const int64_t max_frame = MAX_BODY;
    int64_t last_seq = 0;
    zmq_msg_t last_header, last_body; /* of the call that was answered last */
    peer.silence_ms = 1000;
    peer.hello = hello_of(peer.session, name, capabilities);
    peer.heartbeat = heartbeat_of(peer.session);
    zmq_msg_init(&last_header);
    zmq_msg_init(&last_body);

    void *context = zmq_ctx_new();
    peer.socket = zmq_socket(context, ZMQ_DEALER);
    zmq_setsockopt(peer.socket, ZMQ_LINGER, &linger, sizeof linger);
    zmq_setsockopt(peer.socket, ZMQ_MAXMSGSIZE, &max_frame, sizeof max_frame);
    peer.monitor = monitor_of(context, peer.socket);
    if (zmq_connect(peer.socket, hub) != 0) {
        fprintf(stderr, "%s is not an address of a hub: %s\n", hub, zmq_strerror(zmq_errno()));
        return 1;
    }

    for (;;) {
        zmq_pollitem_t polled[] = {{.socket = peer.monitor, .events = ZMQ_POLLIN},
                                   {.socket = peer.socket, .events = ZMQ_POLLIN}};
        if (zmq_poll(polled, 2, peer.silence_ms) <= 0) {
            if (peer.welcomed) zmq_send(peer.socket, peer.heartbeat.data, peer.heartbeat.size, 0);
            continue;
        }
        if (polled[0].revents & ZMQ_POLLIN) {
            peer.welcomed = 0;
            if (next_event(peer.monitor) == ZMQ_EVENT_HANDSHAKE_SUCCEEDED) greet(&peer);
            continue;
        }
        zmq_msg_t header, body;
        zmq_msg_init(&header);
        zmq_msg_init(&body);
        zmq_msg_recv(&header, peer.socket, 0);
        int frames = 1;
        for (int more = zmq_msg_more(&header); more; more = zmq_msg_more(&body), frames++)
            zmq_msg_recv(&body, peer.socket, 0);

        const uint8_t *start = zmq_msg_data(&header);
        size_t size = zmq_msg_size(&header);
        struct reader reader = {.at = start, .end = start + size};
        int is_array = size > 0 && ((*start & 0xf0) == 0x90 || *start == 0xdc || *start == 0xdd);
        int64_t scalars = next(&reader).whole - 3;
        int64_t kind = next(&reader).whole;
        struct item session = next(&reader);
        int64_t seq = next(&reader).whole;
        struct item items[5] = {{0}};
        for (int i = 0; i < scalars && i < 5; i++) items[i] = next(&reader);
        struct call call = {.kind = kind, .seed = items[0].whole, .reward = items[0].real,
                            .body = zmq_msg_data(&body), .size = zmq_msg_size(&body)};
        int ours = session.size == strlen(peer.session) && memcmp(session.text, peer.session, session.size) == 0;
        int observes = kind == START || kind == STEP;
        if (reader.broken || !is_array || scalars < 0 || size > MAX_HEADER || frames > 2) return malformed();
        if (observes && (frames != 2 || !is_abstract(call.body, call.size))) return malformed();

        if (!ours && session.size > 0) {
            ; /* another session's */
        } else if (kind == WELCOME && peer.welcomed) {
            ; /* it answers no HELLO */
        } else if (kind == WELCOME) {
            peer.welcomed = 1;
            if (!items[1].whole) last_seq = 0;
            double silence_ms = items[2].real * 1000;
            peer.silence_ms = silence_ms >= 10 && silence_ms <= 60000 ? (long)silence_ms : 1000;
            peer.max_body = items[4].whole < MAX_BODY ? (size_t)items[4].whole : MAX_BODY;
        } else if (kind == REFUSE || kind == GOODBYE) {
            struct item text = items[kind == REFUSE];
            fprintf(kind == REFUSE ? stderr : stdout, "%.*s\n", (int)text.size, text.text);
            return kind == REFUSE;
        } else if (kind == ERROR) {
            const char unknown[] = "unknown-peer";
            struct item code = items[0], text = items[1];
            if (code.size != strlen(unknown) || memcmp(code.text, unknown, code.size) != 0)
                fprintf(stderr, "the hub says: %.*s\n", (int)text.size, text.text);
            else if (peer.welcomed)
                greet(&peer);
        } else if (kind == HEARTBEAT || kind == NOTICE) {
            ; /* nothing to do */
        } else if (same(&header, &last_header) && same(&body, &last_body)) {
            last_seq = seq;
            send_reply(peer.socket, &last);
        } else if (seq > last_seq) {
            make_reply(&last, &peer, seq, &call);
            last_seq = seq;
            send_reply(peer.socket, &last);
            zmq_msg_move(&last_header, &header);
            zmq_msg_move(&last_body, &body);
        }
        zmq_msg_close(&header);
        zmq_msg_close(&body);
    }
}
