/* An agent that walks away from where it started, written from docs/protocol.md alone.
 *
 * Build: cc -std=c11 -o agent agent.c -lzmq
 * Usage: ./agent [tcp://127.0.0.1:4097] [session]
 */

#include "peer.h"

static struct {
    int32_t start;
    long episodes;
    double total;
    char seen[128];
} agent;

/* Go up (1) if the first int says that it is not below the start, else down (0). */
static void act(const uint8_t *observation, struct bytes *body) {
    struct counts counts = counts_of(observation), one_int = {.ints = 1};
    double sum = 0;
    for (uint32_t i = 0; i < counts.doubles; i++) sum += double_at(observation, i);
    snprintf(agent.seen, sizeof agent.seen, "%u ints, %u doubles that sum to %g, %u chars", counts.ints,
             counts.doubles, sum, counts.chars);
    int32_t action = counts.ints > 0 && int_at(observation, 0) >= agent.start;
    put(body, &one_int, sizeof one_int);
    put(body, &action, sizeof action);
}

static enum answered answer(const struct call *call, struct bytes *body) {
    char text[256];
    switch (call->kind) {
    case INIT:
        memset(&agent, 0, sizeof agent);
        strcpy(agent.seen, "0 ints, 0 doubles that sum to 0, 0 chars");
        return WITHOUT_BODY;
    case START:
        agent.start = counts_of(call->body).ints > 0 ? int_at(call->body, 0) : 0;
        act(call->body, body);
        return WITH_BODY;
    case STEP:
        agent.total += call->reward;
        act(call->body, body);
        return WITH_BODY;
    case END:
        agent.total += call->reward;
        agent.episodes += 1;
        return WITHOUT_BODY;
    case CLEANUP:
        return WITHOUT_BODY;
    case MESSAGE:
        snprintf(text, sizeof text, "%ld episodes, %g in all; last seen: %s", agent.episodes, agent.total,
                 agent.seen);
        put(body, text, strlen(text));
        return WITH_BODY;
    default:
        return UNKNOWN;
    }
}

int main(int argc, char **argv) {
    const char *const capabilities[] = {NULL};
    return serve(argc, argv, "walker", capabilities);
}
