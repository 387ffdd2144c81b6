// The answer of the API to a method and a path as the scripts write it, with `${...}` for ids and a query.

declare namespace Api {
  type Split<P extends string> = P extends `${infer A}?${string}` ? Split<A> : P extends `/${infer H}/${infer R}` ? [H, ...Split<`/${R}`>] : P extends `/${infer L}` ? [L] : [];
  type Fits<A extends string[], R extends string[]> =
    A extends [infer X extends string, ...infer As extends string[]]
      ? R extends [infer Y extends string, ...infer Rs extends string[]]
        ? Y extends `{${string}}` ? (string extends X ? Fits<As, Rs> : `${number}` extends X ? Fits<As, Rs> : false) : X extends Y ? Fits<As, Rs> : false
        : false
      : R extends [] ? true : false;
  type Key<M extends string, P extends string> = { [K in keyof Answers]: K extends `${M} ${infer R}` ? (Fits<Split<P>, Split<R>> extends true ? K : never) : never }[keyof Answers];
  // a path that the document lacks has no fields at all
  type Answer<M extends string, P extends string> = Answers[Key<M, P>];
}

declare var Plotly: { react(place: string | HTMLElement, traces: object[], layout: object, config: object): void; purge(place: Element): void };
declare var onconnect: (event: MessageEvent) => void;
interface MessagePort { onclose: () => void }

// an element of a page; what it is stands in the document
interface Control extends HTMLElement {
  get value(): string; set value(one: string | number);
  max: number; checked: boolean; disabled: boolean; open: boolean; href: string; pathname: string; required: boolean; options: HTMLOptionsCollection;
  createTHead(): HTMLTableSectionElement; createTBody(): HTMLTableSectionElement;
}

// -- what the scripts make of the answers

type Part = string | Node;
type Content = Part | number | Content[];
type Values = Record<string, any>;
type Units = { robot: string; joints: string[]; length(joint: string, value: number, signed?: boolean): string; scale(joint: string): [number, string]; prismatic: Set<string> };
type Machine = { drives: Api.DrivesView; stop: Api.StopView };
type Here = Omit<Api.MachineDocument, "here"> & { missing: string[] };
type Plan = { id: number; document: Api.PlanView["document"] };
type Swept = { spec: Api.SweepSpec; ramp: number; settle: number };
type View = "side" | "above";

declare namespace Api {
  type Items<P extends string> = Answer<"GET", P> extends { items: infer I } ? I : never;
}

type Sweep = Api.PlannedSweep | Api.PlannedNoise;
type Planned = { robot: string; request: Api.PlanView["document"]["request"]; sweeps: Sweep[]; dropped?: Api.DroppedPose[]; duration: number; pace?: number };
