'use strict';
/** The object dictionary of a drive: CiA 402 in the units of a motor with a gear, nothing of a maker's. */

const { AccessType, DataType, Eds, ObjectType } = require('canopen');

const VENDOR = 0x0A0D, PRODUCT = 0x0402, REVISION = 0x00020000;
const ENCODER = 65536; // increments a motor revolution
const SPEED_UNIT = 0xFDB44700, SPEEDS = 60000.0; // 10^-3 rev/min; so many in 1 rev/s
const GEAR = 100.0;
const RATED = 20.0; // N m of the motor
const MOST = 2000; // per mille of it
const MODES = { csv: 1 << 8 | 1, csp: 1 << 7 | 1 }; // 6502h; profile position is in both
const TURN = GEAR / (2 * Math.PI); // motor revolutions in 1 rad of the joint

const { INTEGER8: I8, INTEGER16: I16, INTEGER32: I32 } = DataType;
const { UNSIGNED8: U8, UNSIGNED16: U16, UNSIGNED32: U32 } = DataType;
const { READ_ONLY: RO, READ_WRITE: RW } = AccessType;

function dictionary(number, modes) {
    const ramp = Math.round(2.0 * TURN * SPEEDS); // 2 rad/s^2
    const fastest = Math.round(1.2 * TURN * SPEEDS);
    const end = Math.round(3.2 * TURN * ENCODER);
    const eds = new Eds({
        vendorName: 'node-canopen', vendorNumber: VENDOR, productName: 'Drive', productNumber: PRODUCT,
        revisionNumber: REVISION, baudRates: [1000000], description: 'CiA 402 on node-canopen',
    });
    eds.setIdentity({ vendorId: VENDOR, productCode: PRODUCT, revisionNumber: REVISION, serialNumber: 0x0A00 + number },
        { saveDefault: true });
    eds.getEntry(0x1000).value = eds.getEntry(0x1000).defaultValue = 0x00020192;

    const one = (index, dataType, accessType, defaultValue, parameterName, more = {}) =>
        eds.addEntry(index, { parameterName, objectType: ObjectType.VAR, dataType, accessType, defaultValue,
            pdoMapping: index >= 0x6000, ...more });
    const many = (index, parameterName, objectType, subs) => {
        const entry = eds.addEntry(index, { parameterName, objectType });
        subs.forEach(([dataType, accessType, defaultValue], k) =>
            eds.addSubEntry(index, k + 1, { parameterName: `${parameterName} ${k + 1}`, objectType: ObjectType.VAR,
                dataType, accessType, defaultValue, pdoMapping: index >= 0x6000 }));
        entry[0].defaultValue = subs.length;
        return entry;
    };

    one(0x1005, U32, RW, 0x80, 'COB-ID SYNC');
    one(0x1006, U32, RW, 0, 'Communication cycle period');
    one(0x1014, U32, RW, 0x80 + number, 'COB-ID EMCY');
    many(0x1016, 'Consumer heartbeat time', ObjectType.ARRAY, [[U32, RW, 0]]);
    one(0x1017, U16, RW, 0, 'Producer heartbeat time');
    one(0x1019, U8, RW, 0, 'Synchronous counter overflow value', { highLimit: 240, lowLimit: 0 });
    many(0x1200, 'SDO server parameter', ObjectType.RECORD, [[U32, RO, 0x600 + number], [U32, RO, 0x580 + number]]);
    for (let k = 0; k < 4; ++k) {
        const off = 0x80000000;
        many(0x1400 + k, `RPDO ${k + 1}`, ObjectType.RECORD, [[U32, RW, off + 0x200 + 0x100 * k + number], [U8, RW, 255]]);
        many(0x1600 + k, `RPDO ${k + 1} mapping`, ObjectType.RECORD, Array(4).fill([U32, RW, 0]));
        many(0x1800 + k, `TPDO ${k + 1}`, ObjectType.RECORD, [[U32, RW, off + 0x180 + 0x100 * k + number], [U8, RW, 1]]);
        many(0x1A00 + k, `TPDO ${k + 1} mapping`, ObjectType.RECORD, Array(4).fill([U32, RW, 0]));
        for (const mapping of [0x1600 + k, 0x1A00 + k]) // off and empty, as from the factory
            eds.getEntry(mapping)[0].value = eds.getEntry(mapping)[0].defaultValue = 0;
    }

    one(0x6007, I16, RW, 1, 'Abort connection option', { lowLimit: 0, highLimit: 3 });
    one(0x603F, U16, RO, 0, 'Error code');
    one(0x6040, U16, RW, 0, 'Controlword');
    one(0x6041, U16, RO, 0, 'Statusword');
    one(0x605A, I16, RW, 2, 'Quick stop option', { lowLimit: 2, highLimit: 6 });
    one(0x605B, I16, RW, 0, 'Shutdown option', { lowLimit: 0, highLimit: 1 });
    one(0x605C, I16, RW, 1, 'Disable operation option', { lowLimit: 0, highLimit: 1 });
    one(0x605D, I16, RW, 1, 'Halt option', { lowLimit: 1, highLimit: 2 });
    one(0x605E, I16, RW, 2, 'Fault reaction option', { lowLimit: 1, highLimit: 2 });
    one(0x6060, I8, RW, 0, 'Mode of operation');
    one(0x6061, I8, RO, 0, 'Mode of operation display');
    one(0x6064, I32, RO, 0, 'Position actual value');
    one(0x606C, I32, RO, 0, 'Velocity actual value');
    one(0x6072, U16, RW, MOST, 'Max torque');
    one(0x6076, U32, RO, Math.round(RATED * 1e3), 'Rated torque');
    one(0x6077, I16, RO, 0, 'Torque actual value');
    one(0x607A, I32, RW, 0, 'Target position');
    many(0x607D, 'Position limits', ObjectType.ARRAY, [[I32, RW, -end], [I32, RW, end]]);
    one(0x607F, U32, RW, fastest, 'Max profile velocity');
    one(0x6080, U32, RW, Math.round(1.2 * TURN * 60), 'Max motor speed'); // rev/min
    one(0x6081, U32, RW, 0, 'Profile velocity');
    one(0x6083, U32, RW, ramp, 'Profile acceleration');
    one(0x6084, U32, RW, ramp, 'Profile deceleration');
    one(0x6085, U32, RW, ramp, 'Quick stop deceleration');
    many(0x608F, 'Encoder resolution', ObjectType.ARRAY, [[U32, RO, ENCODER], [U32, RO, 1]]);
    one(0x60A9, U32, RO, SPEED_UNIT, 'SI unit velocity');
    many(0x60C2, 'Interpolation time period', ObjectType.RECORD, [[U8, RW, 8], [I8, RW, -3]]);
    one(0x60FF, I32, RW, 0, 'Target velocity');
    one(0x6502, U32, RO, MODES[modes], 'Supported drive modes');
    return eds;
}

const IDENTITY = [VENDOR, PRODUCT, REVISION];

module.exports = { dictionary, ENCODER, GEAR, IDENTITY, RATED, SPEEDS, TURN };
