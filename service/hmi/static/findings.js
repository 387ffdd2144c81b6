// What the check of the data found: sentence and what to do, the severe ones first.

import { element } from "./elements.js";

export function findingParts(findings) {
  const ordered = findings.toSorted((one, other) => (other.severity === "wrong") - (one.severity === "wrong"));
  return ordered.map((finding) => {
    const line = element("p", undefined, `finding ${finding.severity}`);
    line.append(element("b", `${finding.severity}: `), `${finding.sentence} ${finding.action}`);
    return line;
  });
}
