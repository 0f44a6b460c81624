/* Programs for the original RL-Glue: an agent and an environment that do nothing, and an experiment.
 *
 *     cc -O2 -o original original.c
 *     original agent|environment|experiment PORT INTS DOUBLES CHARS
 *
 * They speak the original's binary format (docs/legacy.md) as its C codec does, with two sends per frame, so that
 * the same programs measure the original server and the gateway. The experiment reads lines `step N` or `episode N`
 * and answers each with the seconds that N steps took.
 */
#include <arpa/inet.h>
#include <netinet/tcp.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <time.h>
#include <unistd.h>

enum {
    EXPERIMENT = 1, AGENT = 2, ENVIRONMENT = 3, AGENT_START = 5, AGENT_STEP = 6, ENV_INIT = 11, ENV_START = 12,
    ENV_STEP = 13, RL_INIT = 20, RL_START = 21, RL_STEP = 22, RL_EPISODE = 27, RL_TERM = 35
};

static const char TASK_SPEC[] = "benchmark";
static int hub;
static uint32_t size; /* of the payload received last */
static unsigned char payload[1 << 16], observation[1 << 16];
static uint32_t observation_size;
static const unsigned char ACTION[] = {0, 0, 0, 1, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 1};

static void fail(const char *what) {
    perror(what);
    exit(1);
}

static void put(uint32_t number, unsigned char *at) {
    number = htonl(number);
    memcpy(at, &number, 4);
}

static void send_all(const void *data, size_t length) {
    for (const char *at = data; length > 0;) {
        ssize_t sent = send(hub, at, length, 0);
        if (sent <= 0) fail("send");
        at += sent;
        length -= sent;
    }
}

static void send_frame(uint32_t id, const void *data, uint32_t length) {
    unsigned char head[8];
    put(id, head);
    put(length, head + 4);
    send_all(head, sizeof head);
    if (length) send_all(data, length);
}

static int receive_all(void *data, size_t length) {
    for (char *at = data; length > 0;) {
        ssize_t received = recv(hub, at, length, 0);
        if (received <= 0) return 0;
        at += received;
        length -= received;
    }
    return 1;
}

static uint32_t receive_frame(void) {
    uint32_t head[2];
    if (!receive_all(head, sizeof head)) exit(0);
    size = ntohl(head[1]);
    if (size > sizeof payload || !receive_all(payload, size)) fail("receive");
    return ntohl(head[0]);
}

static void serve(void) {
    unsigned char text[4 + sizeof TASK_SPEC], reply[sizeof observation + 12];
    const double reward = 1.0;
    uint64_t bits;
    put(sizeof TASK_SPEC - 1, text);
    memcpy(text + 4, TASK_SPEC, sizeof TASK_SPEC - 1);
    put(0, reply);
    memcpy(&bits, &reward, 8);
    put(bits >> 32, reply + 4);
    put((uint32_t)bits, reply + 8);
    memcpy(reply + 12, observation, observation_size);
    for (;;) {
        uint32_t id = receive_frame();
        switch (id) {
        case AGENT_START:
        case AGENT_STEP: send_frame(id, ACTION, sizeof ACTION); break;
        case ENV_INIT: send_frame(id, text, 3 + sizeof TASK_SPEC); break;
        case ENV_START: send_frame(id, observation, observation_size); break;
        case ENV_STEP: send_frame(id, reply, 12 + observation_size); break;
        case RL_TERM: exit(0);
        default: send_frame(id, NULL, 0);
        }
    }
}

static void experiment(void) {
    char verb[16];
    unsigned char limit[4];
    unsigned steps;
    send_frame(RL_INIT, NULL, 0);
    receive_frame();
    while (scanf("%15s %u", verb, &steps) == 2) {
        struct timespec began, ended;
        clock_gettime(CLOCK_MONOTONIC, &began);
        if (!strcmp(verb, "episode")) {
            put(steps, limit);
            send_frame(RL_EPISODE, limit, sizeof limit);
            receive_frame();
        } else {
            send_frame(RL_START, NULL, 0);
            receive_frame();
            for (unsigned i = 0; i < steps; i++) {
                send_frame(RL_STEP, NULL, 0);
                receive_frame();
            }
        }
        clock_gettime(CLOCK_MONOTONIC, &ended);
        printf("%.9f\n", ended.tv_sec - began.tv_sec + (ended.tv_nsec - began.tv_nsec) / 1e9);
        fflush(stdout);
    }
    send_frame(RL_TERM, NULL, 0);
}

int main(int argc, char **argv) {
    const int on = 1;
    struct sockaddr_in address = {.sin_family = AF_INET, .sin_addr.s_addr = htonl(INADDR_LOOPBACK)};
    if (argc != 6) return 2;
    address.sin_port = htons((uint16_t)atoi(argv[2]));
    for (int tries = 0;; tries++) {
        hub = socket(AF_INET, SOCK_STREAM, 0);
        if (!connect(hub, (struct sockaddr *)&address, sizeof address)) break;
        if (tries == 100) fail("connect");
        close(hub);
        usleep(100000);
    }
    setsockopt(hub, IPPROTO_TCP, TCP_NODELAY, &on, sizeof on);
    for (int i = 0; i < 3; i++) put((uint32_t)atoi(argv[3 + i]), observation + 4 * i);
    observation_size = 12 + 4 * atoi(argv[3]) + 8 * atoi(argv[4]) + atoi(argv[5]);
    if (observation_size > sizeof observation) return 2;
    if (!strcmp(argv[1], "experiment")) {
        send_frame(EXPERIMENT, NULL, 0);
        experiment();
    } else {
        send_frame(strcmp(argv[1], "agent") ? ENVIRONMENT : AGENT, NULL, 0);
        serve();
    }
    return 0;
}
