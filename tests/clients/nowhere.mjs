// An environment whose second mask leaves the second int of an action no legal value.
import { serveEnvironment } from "glue-rl";

const masked = (somewhere) => ({ ints: [0], mask: [0, 1, 0, somewhere, 0] });
await serveEnvironment({
  init: () => "TASK_SPEC",
  start: () => masked(1),
  step: () => ({ reward: 0, terminal: false, observation: masked(0) }),
});
