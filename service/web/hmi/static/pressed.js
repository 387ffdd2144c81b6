// What is known of a press of STOP from the answers of its ways, and what a person reads of it. No page, no network.

export const LIMIT = 1000; // ms until the page says that STOP is not confirmed

/**
 * late: LIMIT has passed. waiting: ways without an answer. latched: the machine is held
 * @typedef {{left: boolean, confirmed: readonly string[], unconfirmed: Record<string, string>, late: boolean, refusal: string, waiting: number, latched: boolean}} Press
 * @typedef {{status: number, content: {confirmed?: readonly string[], unconfirmed?: Record<string, string>, detail?: string}}} StopAnswer
 */

// ways: their number
/** @param {number} ways @returns {Press} */
export const pressed = (ways) => ({ left: false, confirmed: [], unconfirmed: {}, late: false, refusal: "", waiting: ways, latched: false });

/** @param {StopAnswer} answer @param {Press} press @returns {Partial<Press>} */
export function heard({ status, content: { confirmed = [], unconfirmed, detail } }, press) {
  return {
    left: true,
    confirmed: [...press.confirmed, ...confirmed],
    unconfirmed: { ...press.unconfirmed, ...unconfirmed },
    refusal: unconfirmed || status < 400 ? press.refusal : detail,
  };
}

// text: its key. axes: which are named, and why. A positive report counts by any way; each answer lists all axes
/** @param {Press} press */
export function told({ left, confirmed, unconfirmed, late, refusal, waiting }) {
  const axes = Object.fromEntries(Object.entries(unconfirmed).filter(([joint]) => !confirmed.includes(joint)));
  const named = Object.keys(axes).length > 0;
  const over = late || waiting === 0;
  /** @param {string} text */
  const say = (text) => ({ text, axes, refusal, over });
  if (confirmed.length && !named) return say("stop.confirmed");
  if (!over) return say(left ? "stop.sent" : "stop.sending");
  if (!left) return say("stop.not-left");
  if (named) return say("stop.unconfirmed");
  return say(refusal ? "stop.refused" : "stop.late");
}
