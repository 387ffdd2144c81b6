'use strict';
/**
 * One axis: an inertia with friction under a PI speed controller. SI units of the joint. The torque is constant over a
 * step; viscous friction is taken at its middle, and so is the speed that TPDOs report.
 */

const STEP = 2.5e-4; // s
const SLOPE = 2e-3; // rad/s: below it Coulomb's friction is a viscous one
const BANDWIDTH = 25.0, RESET = 5.0; // Hz, of the speed controller and of its integrator

class Plant {
    constructor({ inertia, coulomb, viscous, seed }) {
        Object.assign(this, { inertia, coulomb, viscous, seed });
        this.position = 0.0;
        this.effortLimit = Infinity;
        this.stand();
    }

    /** The brake is closed. */
    stand() {
        this.velocity = this.meanVelocity = this.effort = this.sum = 0.0;
    }

    /** One `STEP` at a speed set-point in rad/s. */
    step(wanted) {
        const gain = this.inertia * 2 * Math.PI * BANDWIDTH;
        const error = wanted - this.velocity;
        const effort = gain * error + this.sum;
        this.effort = Math.min(Math.max(effort, -this.effortLimit), this.effortLimit);
        if (this.effort === effort) // no wind-up in the limit
            this.sum += gain * 2 * Math.PI * RESET * error * STEP;
        const before = this.velocity, dry = this.coulomb * Math.tanh(before / SLOPE);
        const momentum = this.inertia / STEP, half = this.viscous / 2;
        this.velocity = ((momentum - half) * before + this.effort - dry) / (momentum + half);
        this.meanVelocity = (before + this.velocity) / 2;
        this.position += this.meanVelocity * STEP;
    }

    /** White noise of variance 1, the same in every run: twelve numbers of a linear congruential generator. */
    noise() {
        let sum = -6.0;
        for (let k = 0; k < 12; ++k) {
            this.seed = (Math.imul(this.seed, 1664525) + 1013904223) >>> 0;
            sum += this.seed / 2 ** 32;
        }
        return sum;
    }
}

module.exports = { Plant, STEP };
