'use strict';

/** CRC-16-CCITT of CiA 301 (polynomial 1021h, start 0), the only one that node-canopen asks for. Gives two bytes. */
function crc(width, reflected, polynomial, start, _startHigh, _final, _finalHigh, _reflectedOut, data) {
    if (width !== 16 || reflected)
        throw new RangeError(`CRC of ${width} bits${reflected ? ', reflected' : ''}: only CRC-16-CCITT is here`);

    let sum = start;
    for (const byte of data) {
        sum ^= byte << 8;
        for (let bit = 0; bit < 8; ++bit)
            sum = (sum & 0x8000 ? sum << 1 ^ polynomial : sum << 1) & 0xFFFF;
    }
    const result = Buffer.alloc(2);
    result.writeUInt16BE(sum);
    return result;
}

module.exports = { crc };
