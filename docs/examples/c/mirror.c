/* The mirror's agent of docs/clients.md, with which glue-conform judges peer.h.
 *
 * Build: cc -std=c11 -o mirror mirror.c -lzmq
 * Usage: glue-conform agent -- ./mirror
 */

#include "peer.h"

static int32_t count;
static uint64_t seed;

static void act(const uint8_t *observation, double reward, struct bytes *body) {
    struct counts counts = counts_of(observation), mirrored = counts;
    const uint8_t *chars = observation + 16 + 8 * (size_t)counts.doubles + 4 * (size_t)counts.ints;
    double sum = 0;
    if (counts.ints == 0 && counts.doubles == 0 && counts.chars == 0) {
        put(body, &counts, sizeof counts);
        return;
    }
    mirrored.ints += 1;
    mirrored.doubles += 2;
    put(body, &mirrored, sizeof mirrored);
    for (uint32_t i = counts.doubles; i-- > 0;) {
        double value = double_at(observation, i);
        put(body, &value, sizeof value);
    }
    for (uint32_t i = 0; i < counts.ints; i++) sum += int_at(observation, i);
    put(body, &sum, sizeof sum);
    put(body, &reward, sizeof reward);
    for (uint32_t i = counts.ints; i-- > 0;) {
        int32_t value = int_at(observation, i);
        put(body, &value, sizeof value);
    }
    put(body, &count, sizeof count);
    for (uint32_t i = counts.chars; i-- > 0;) put(body, chars + i, 1);
}

static enum answered answer(const struct call *call, struct bytes *body) {
    char text[64] = {0};
    switch (call->kind) {
    case INIT:
        count = 0;
        return WITHOUT_BODY;
    case START:
    case STEP:
        count += 1;
        act(call->body, call->kind == START ? 0.0 : call->reward, body);
        return WITH_BODY;
    case END:
        count += 1;
        return WITHOUT_BODY;
    case CLEANUP:
        return WITHOUT_BODY;
    case MESSAGE:
        if (call->size == 4 && memcmp(call->body, "fail", 4) == 0) {
            put(body, "asked to fail", strlen("asked to fail"));
            return FAILED;
        }
        put(body, call->body, call->size);
        return WITH_BODY;
    case SEED:
        seed = (uint64_t)call->seed;
        return WITHOUT_BODY;
    case SAVE:
        snprintf(text, sizeof text, "%" PRId32 " %" PRIu64, count, seed);
        put(body, text, strlen(text));
        return WITH_BODY;
    case LOAD:
        memcpy(text, call->body, call->size < sizeof text ? call->size : sizeof text - 1);
        sscanf(text, "%" SCNd32 " %" SCNu64, &count, &seed);
        return WITHOUT_BODY;
    default:
        return UNKNOWN;
    }
}

int main(int argc, char **argv) {
    const char *const capabilities[] = {"save", "seed", NULL};
    return serve(argc, argv, "mirror", capabilities);
}
