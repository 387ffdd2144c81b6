'use strict';
/**
 * Machine of node-canopen's nodes: node main.js socketcand|FD csv|csp
 *
 * FD is the number of an open SocketCAN socket. tests/independent_bench.py says what it prints when it is ready.
 */

const fs = require('fs');
const net = require('net');
const os = require('os');
const path = require('path');
const { KernelBus, SocketcandServer } = require('./bus');
const { Drive } = require('./drive');
const { GEAR, IDENTITY, RATED } = require('./objects');
const { Plant, STEP } = require('./plant');

const INERTIAS = { joint_1: 149.0, joint_3: 53.0 }; // kg m^2
const FRICTION = { coulomb: 110.0, viscous: 1400.0 }; // N m, N m s/rad
const EMERGENCY_STOP = 0x9000;
const TICK = 2; // ms
const BACKLOG = 2.0; // s that are made up for on a busy computer

const seconds = () => Number(process.hrtime.bigint()) * 1e-9;

class Machine {
    constructor(where, modes) {
        const receive = (id, data) => Object.values(this.drives).forEach((drive) => drive.receive(id, data));
        this.bus = where === 'socketcand' ? new SocketcandServer('can0', receive) : new KernelBus(Number(where), receive);
        this.time = seconds();
        this.drives = {};
        Object.entries(INERTIAS).forEach(([joint, inertia], k) => {
            const plant = new Plant({ inertia, ...FRICTION, seed: k + 1 });
            this.drives[joint] = new Drive(k + 1, modes, plant, (id, data) => this.bus.send(id, data));
        });
    }

    run() {
        const now = seconds();
        this.time = Math.max(this.time, now - BACKLOG);
        const steps = Math.floor((now - this.time) / STEP);
        this.time += steps * STEP;
        for (const drive of Object.values(this.drives))
            drive.run(now, steps);
    }

    /** The EDS of the first drive, as the stack writes it. */
    eds() {
        const folder = fs.mkdtempSync(path.join(os.tmpdir(), 'node-canopen-'));
        try {
            this.drives.joint_1.eds.save(path.join(folder, 'drive.eds'));
            return fs.readFileSync(path.join(folder, 'drive.eds'), 'latin1');
        }
        finally {
            fs.rmSync(folder, { recursive: true });
        }
    }

    carryOut({ order, joint, ...more }) {
        const drive = this.drives[joint];
        const drives = Object.entries(this.drives);
        switch (order) {
            case 'status':
                return {
                    axes: Object.fromEntries(drives.map(([name, each]) => [name, truth(each)])),
                    sync_counter: Math.max(...drives.map(([, each]) => each.syncs)),
                };
            case 'emergency_stop': drives.forEach(([, each]) => each.press(more.on, EMERGENCY_STOP)); break;
            case 'fault': drive.fail(more.code); break;
            case 'silence': drive.mute = more.on; break;
            case 'drop_tpdos': drive.tpdosToLose = more.count; break;
            case 'identity': drive.eds.setIdentity({ productCode: more.product }); break;
            case 'sync_counter': drive.eds.getEntry(0x1019).value = more.raw; break;
            case 'reboot': drive.device.nmt.resetNode(); break;
            default: throw new RangeError(`unknown order ${order}`);
        }
        return {};
    }
}

function truth({ plant, energised, code, state }) {
    const { position, velocity, effort } = plant;
    return { position, velocity, effort, energised, fault: code, state };
}

async function main([where, modes]) {
    const machine = new Machine(where, modes);
    const orders = net.createServer((socket) => {
        let received = '';
        socket.on('error', () => socket.destroy());
        socket.on('data', (bytes) => {
            received += bytes;
            if (received.includes('\n'))
                socket.end(JSON.stringify({ ...machine.carryOut(JSON.parse(received)), ok: true }) + '\n');
        });
    });
    await new Promise((resolve) => orders.listen(0, '127.0.0.1', resolve));
    const ready = { port: await machine.bus.listen(), control_port: orders.address().port };
    setInterval(() => machine.run(), TICK);
    const kind = { identity: IDENTITY, gear: GEAR, rated: RATED };
    console.log(JSON.stringify({ ...ready, ...kind, eds: machine.eds(), inertias: INERTIAS }));
}

process.on('SIGTERM', () => process.exit(0));
main(process.argv.slice(2));
