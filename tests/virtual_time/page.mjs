// What the page says of recorded presses: node page.mjs pressed.mjs PRESSES TOLD (JSON files)
//
// A press is a list of answers {way, at, status, body} in s after it, of the ways "port" and "api"; the requests left.
// Told is, for each press, what a person reads after each event and at `until` s: {at, text, axes}.

import { readFileSync, writeFileSync } from "node:fs";

const [, , module, presses, place] = process.argv;
const { LIMIT, heard, pressed, told } = await import(module);

function read({ until, answers }) {
  const press = { ...pressed(2), left: true };
  const events = answers.map(({ at, way, status, body }) => {
    const { confirmed, unconfirmed } = body;
    const content = way === "api" ? body : { confirmed, unconfirmed };
    return { at, more: () => ({ ...heard({ status, content }, press), waiting: press.waiting - 1 }) };
  });
  events.push({ at: LIMIT / 1000, more: () => ({ late: true }) }, { at: until, more: () => ({}) });
  const due = events.filter(({ at }) => at <= until).sort((one, other) => one.at - other.at);
  return due.map(({ at, more }) => {
    Object.assign(press, more());
    const { text, axes } = told(press);
    return { at, text, axes: Object.keys(axes) };
  });
}

writeFileSync(place, JSON.stringify(JSON.parse(readFileSync(presses)).map(read)));
