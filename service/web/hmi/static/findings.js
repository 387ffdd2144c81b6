// Findings of the data check: sentence and action, severe findings first.

import { element } from "./elements.js";
import { foreign, word } from "./words.js";

/** @param {(Pick<Api.Finding, "severity" | "sentence" | "action"> & {code?: string, effect?: string})[]} findings */
export function findingParts(findings) {
  const ordered = findings.toSorted((one, other) => Number(other.severity === "wrong") - Number(one.severity === "wrong"));
  return ordered.map((finding) => {
    const line = element("p", undefined, `finding ${finding.severity}`);
    const what = finding.code ? word("finding", finding.code) : word("effect", finding.effect ?? "");
    line.append(element("b", `${word("severity", finding.severity)}, ${what}: `), foreign(finding.sentence), " ", foreign(finding.action));
    return line;
  });
}
