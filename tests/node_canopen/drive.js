'use strict';
/** One drive: the power state machine of IEC 61800-7-201 and its set-points, on a node-canopen device and a plant. */

const { Device, NmtState } = require('canopen');
const { dictionary, ENCODER, GEAR, RATED, SPEEDS, TURN } = require('./objects');
const { STEP } = require('./plant');

const State = { DISABLED: 0x40, READY: 0x21, ON: 0x23, ENABLED: 0x27, QUICK: 0x07, REACTION: 0x0F, FAULT: 0x08 };
const ENERGISED = new Set([State.ENABLED, State.QUICK, State.REACTION]);
const PP = 1, CSP = 8, CSV = 9;
const SYNC = 0x80;
const SYNC_LOST = 5.0; // s without SYNC, after which time goes on by itself
const LAG = 0.05, LAG_TIME = 0.2; // rad/s of set-point and speed apart, for s: fault 8400h
const JUMP = 0.05; // rad from one position target to the next: fault 8611h
const STANDS = 9e-4; // rad/s
const SETTLED = 0.02; // s of standstill before the target is reached, as 6068h: the speed swings through zero
const STIFFNESS = 10.0; // 1/s, of the position controller
const NOISE = 1.0; // per mille of the rated torque, of the torque that is told

const clamp = (value, most) => Math.min(Math.max(value, -most), most);
const towards = (value, goal, step) => value + clamp(goal - value, step);

class Drive {
    /** `send(id, data)` puts a frame on the bus. */
    constructor(number, modes, plant, send) {
        this.number = number;
        this.plant = plant;
        this.mute = false;
        this.tpdosToLose = 0;
        this.syncs = 0;
        this.synced = -Infinity;
        this.now = 0.0;
        this.state = State.DISABLED;
        this.code = 0;
        this.pressed = false;
        this.word = this.mode = 0;
        this.lagging = this.still = 0.0;
        this.after = null; // state at the end of a ramp
        this._begin();
        this.eds = dictionary(number, modes);
        this.device = new Device({ eds: this.eds, id: number });
        this.device.addListener('message', ({ id, data }) => this._send(id, data, send));
        this.device.nmt.addListener('timeout', () => this._loseHost(0x8130));
        this.device.nmt.addListener('changeState', (state) => this._changed(state));
        this.device.pdo.addListener('pdo', () => this._control());
        this.eds.getEntry(0x6040).addListener('update', () => this._control());
        this.tell();
        this.device.start();
    }

    /** A frame of the bus. What TPDOs tell is of the moment of SYNC: node-canopen sends them before it says so. */
    receive(id, data) {
        if (this.mute)
            return;
        if (id === SYNC)
            this._sync(data);
        else
            this.device.receive({ id, data, len: data.length });
    }

    /** `steps` of the plant have gone by on the clock (`now`, s), unless SYNC leads. */
    run(now, steps) {
        this.now = now;
        if (!this._led) {
            this._advance(steps);
            const { position, velocity, effort } = this.plant;
            this.means = [position, velocity, effort]; // a mean over a busy time would lag behind "target reached"
        }
        this.tell();
    }

    get _led() {
        return this.state === State.ENABLED && this.mode !== PP && this.now - this.synced < SYNC_LOST;
    }

    get(index, sub = 0) {
        const entry = this.eds.getEntry(index);
        return (sub ? entry[sub] : entry).value;
    }

    // -- bus ----------------------------------------------------------------------------------------------------

    _send(id, data, send) {
        if ([0x180, 0x280, 0x380, 0x480].includes(id & ~0x7F) && this.tpdosToLose > 0)
            this.tpdosToLose -= 1;
        else if (!this.mute)
            send(id, data);
    }

    _sync(data) {
        if (data.length !== (this.get(0x1019) ? 1 : 0)) { // CiA 301: EMCY, and the SYNC does not count
            this._emergency(0x8240);
            return;
        }
        const led = this._led;
        this.synced = this.now;
        this.syncs += 1;
        if (led)
            this._advance(Math.round(this.get(0x1006) * 1e-6 / STEP));
        this.tell();
        this.device.receive({ id: SYNC, data, len: data.length });
    }

    /** CiA 301: a stopped node sends no EMCY; node-canopen throws then. */
    _emergency(code) {
        if ([NmtState.PRE_OPERATIONAL, NmtState.OPERATIONAL].includes(this.device.state))
            this.device.emcy.write(code);
    }

    _changed(state) {
        if (state === NmtState.STOPPED)
            this._loseHost(0x8100);
        else if (state === NmtState.INITIALIZING)
            this._enter(State.DISABLED);
        else if (state === NmtState.PRE_OPERATIONAL && this.booting)
            this.device.emit('message', { id: 0x700 + this.number, data: Buffer.from([0]) }); // the stack sends none
        this.booting = state === NmtState.INITIALIZING;
    }

    _loseHost(code) {
        const option = this.get(0x6007);
        if (!ENERGISED.has(this.state) || option === 0)
            return;
        if (option === 1)
            this.fail(code);
        else if (option === 2)
            this._enter(State.DISABLED);
        else
            [this.state, this.after] = [State.QUICK, State.DISABLED];
        this.tell();
    }

    // -- motion -------------------------------------------------------------------------------------------------

    _begin() {
        this.speed = 0.0; // of the profile or of the interpolation, rad/s
        this.goal = null; // of the interpolation: rad/s in csv, rad in csp
        this.left = 0; // steps of it to go
        this.target = null; // of profile position, rad
        this.reference = this.plant.position; // rad
        this.acknowledged = false;
        this.means = [this.plant.position, 0.0, 0.0]; // position, speed, effort over the last SYNC period
    }

    _advance(steps) {
        if (!ENERGISED.has(this.state) || steps <= 0)
            return;
        const plant = this.plant, means = [0.0, 0.0, 0.0];
        plant.effortLimit = this.get(0x6072) * 1e-3 * RATED * GEAR;
        if (this.state === State.ENABLED && this.mode !== PP)
            this._aim();
        for (let k = 0; k < steps; ++k) {
            const wanted = this._setPoint();
            plant.step(wanted);
            this._watch(wanted);
            if (!ENERGISED.has(this.state))
                return;
            means[0] += plant.position / steps;
            means[1] += plant.meanVelocity / steps;
            means[2] += plant.effort / steps;
        }
        this.means = means;
    }

    /** The target of a cyclic mode, to be reached in the interpolation period. */
    _aim() {
        const period = this.get(0x60C2, 1) * 10 ** this.get(0x60C2, 2);
        const goal = this.mode === CSV ? this._speedOf(0x60FF) : this.get(0x607A) / (TURN * ENCODER);
        if (this.mode === CSP && Math.abs(goal - this.reference) > JUMP)
            this.fail(0x8611);
        else if (goal !== this.goal)
            [this.goal, this.left] = [goal, Math.round(period / STEP)];
    }

    _setPoint() {
        if (this.after !== null || this.state !== State.ENABLED)
            return this._ramped(0.0, 0x6085);
        if (this.mode === PP)
            return this._travelled();
        if (this.mode === CSV) {
            if (this.left > 0)
                this.speed += (this.goal - this.speed) / this.left--;
            return this.speed;
        }
        if (this.mode !== CSP)
            return this._ramped(0.0, 0x6085);
        this.speed = this.left > 0 ? (this.goal - this.reference) / (this.left-- * STEP) : 0.0;
        this.reference += this.speed * STEP;
        return this.speed + STIFFNESS * (this.reference - this.plant.position);
    }

    _ramped(goal, ramp) {
        this.speed = towards(this.speed, goal, this._speedOf(ramp) * STEP);
        return this.speed;
    }

    /** To the target along a trapezoid, and held there. */
    _travelled() {
        if (this.target !== null) {
            const left = this.target - this.reference;
            const most = Math.min(this._speedOf(0x6081), this._speedOf(0x607F));
            const allowed = 0.98 * Math.sqrt(2 * this._speedOf(0x6084) * Math.abs(left));
            this._ramped(Math.sign(left) * Math.min(most, allowed), 0x6083);
            if (Math.abs(left) <= Math.abs(this.speed) * STEP || Math.abs(left) < 1e-9)
                [this.reference, this.speed] = [this.target, 0.0];
            else
                this.reference += this.speed * STEP;
        }
        return this.speed + STIFFNESS * (this.reference - this.plant.position);
    }

    _watch(wanted) {
        this.lagging = Math.abs(wanted - this.plant.velocity) > LAG ? this.lagging + STEP : 0.0;
        this.still = Math.abs(this.plant.velocity) < STANDS ? this.still + STEP : 0.0;
        const [low, high] = [1, 2].map((sub) => this.get(0x607D, sub) / (TURN * ENCODER));
        if (this.state === State.ENABLED && this.lagging > LAG_TIME)
            this.fail(0x8400);
        else if (this.state === State.ENABLED && !(low <= this.plant.position && this.plant.position <= high))
            this.fail(0x8612);
        else if (this.after !== null && this.speed === 0.0 && Math.abs(this.plant.velocity) < STANDS)
            this._enter(this.after);
    }

    _speedOf(index) {
        return this.get(index) / SPEEDS / TURN;
    }

    // -- power --------------------------------------------------------------------------------------------------

    _control() {
        const before = this.word, word = this.word = this.get(0x6040);
        const { DISABLED, READY, ON, ENABLED, QUICK, REACTION, FAULT } = State;
        if (this.state === FAULT) {
            if (word & ~before & 0x80 && !this.pressed) {
                this.code = 0;
                this._emergency(0);
                this._enter(DISABLED);
            }
        }
        else if (this.state === REACTION)
            return;
        else if (!(word & 0x02))
            this._enter(DISABLED);
        else if (!(word & 0x04)) {
            if (this.state === ENABLED) {
                [this.state, this.lagging] = [QUICK, 0.0];
                this.after = this.get(0x605A) === 2 ? DISABLED : null;
            }
            else if (this.state !== QUICK)
                this._enter(DISABLED);
        }
        else if ((word & 0x07) === 0x06 && this.state !== QUICK)
            this._enter(READY);
        else if ((word & 0x0F) === 0x07)
            this._enter({ [READY]: ON, [ENABLED]: ON }[this.state] ?? this.state);
        else if ((word & 0x0F) === 0x0F && this.state === ON) {
            this._enter(ENABLED);
            this._begin();
        }
        else if ((word & 0x0F) === 0x0F && this.state === ENABLED)
            this._operate(before);
        this.tell();
    }

    _operate(before) {
        if (this.mode !== PP)
            return;
        if (!(this.word & 0x10))
            this.acknowledged = false;
        else if (!(before & 0x10)) {
            this.target = this.get(0x607A) / (TURN * ENCODER);
            this.acknowledged = true;
        }
    }

    _enter(state) {
        if (state !== this.state)
            [this.after, this.lagging] = [null, 0.0];
        this.state = state;
        if (!ENERGISED.has(state)) {
            this.speed = 0.0;
            this.plant.stand();
        }
    }

    /** A fault: the axis brakes, then loses its energy. */
    fail(code) {
        this.code = code;
        this._emergency(code);
        if (ENERGISED.has(this.state) && this.get(0x605E) === 2)
            [this.state, this.after] = [State.REACTION, State.FAULT];
        else
            this._enter(State.FAULT);
        this.tell();
    }

    /** Safe torque off: at once. */
    press(on, code) {
        this.pressed = on;
        if (on) {
            this.code = code;
            this._emergency(code);
            this._enter(State.FAULT);
        }
        this.tell();
    }

    // -- actual values ------------------------------------------------------------------------------------------

    tell() {
        const energised = ENERGISED.has(this.state), stands = Math.abs(this.plant.velocity) < STANDS;
        const asked = this.get(0x6060);
        if (asked !== this.mode && stands && this.speed === 0.0) {
            this.mode = asked;
            this._begin();
        }
        const arrived = this.mode !== PP || this.target === null || this.reference === this.target;
        let word = this.state | 0x200 | (this.pressed ? 0 : 0x10);
        const settled = this.mode === PP ? this.still >= SETTLED : stands;
        if (energised && settled && arrived && this.left === 0)
            word |= 0x400;
        if (this.state === State.ENABLED && (this.mode === PP ? this.acknowledged : this.mode === CSV || this.mode === CSP))
            word |= 0x1000;
        if (!energised)
            this.means = [this.plant.position, 0.0, 0.0];
        const [position, velocity, effort] = this.means;
        const noise = energised ? NOISE * this.plant.noise() : 0.0;
        this._set(0x603F, this.code);
        this._set(0x6041, word);
        this._set(0x6061, this.mode);
        this._set(0x6064, position * TURN * ENCODER);
        this._set(0x606C, velocity * TURN * SPEEDS);
        this._set(0x6077, clamp(effort / (RATED * GEAR) * 1e3 + noise, 32767));
    }

    _set(index, value) {
        this.eds.getEntry(index).value = Math.round(value);
    }

    get energised() {
        return ENERGISED.has(this.state);
    }
}

module.exports = { Drive };
