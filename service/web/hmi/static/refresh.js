// One refresh at a time: requests during a refresh cause one further refresh.

import { Silent } from "./api.js";
import { complain } from "./elements.js";

export function refresher(show) {
  let refreshing = false;
  let again = false;
  return async () => {
    again = true;
    if (refreshing) return;
    refreshing = true;
    try {
      while (again) {
        again = false;
        await show();
      }
    } catch (error) {
      if (!(error instanceof Silent)) complain(error);
    } finally {
      refreshing = false;
    }
  };
}
