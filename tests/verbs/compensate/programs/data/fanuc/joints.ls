/PROG  JOINTS
/ATTR
OWNER		= MNEDITOR;
COMMENT		= "";
PROG_SIZE	= 900;
LINE_COUNT	= 4;
PROTECT		= READ_WRITE;
TCD:  STACK_SIZE	= 0,
      PAUSE_REQUEST	= 0;
DEFAULT_GROUP	= 1,1,*,*,*;
CONTROL_CODE	= 00000000 00000000;
/APPL
/MN
   1:J P[1:start] 100% FINE ;
   2:L P[2] 800mm/sec CNT50 ;
   3:J P[3] 50% CNT100 Wjnt ;
   4:J P[1:start] 100% FINE ;
/POS
P[1:"start"]{
   GP1:
	UF : 0, UT : 1,	
	J1=    10.000 deg,	J2=     5.000 deg,	J3=   -15.000 deg,
	J4=    20.000 deg,	J5=   -60.000 deg,	J6=    30.000 deg
   GP2:
	UF : 0, UT : 1,	
	J1=     0.000  mm
};
P[2]{
   GP1:
	UF : 0, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X =   910.824  mm,	Y =  -357.569  mm,	Z =   155.835  mm,
	W =  -176.716 deg,	P =   -14.358 deg,	R =    68.812 deg
   GP2:
	UF : 0, UT : 1,	
	J1=     0.000  mm
};
P[3]{
   GP1:
	UF : 0, UT : 5,	
	J1=    35.000 deg,	J2=   -10.000 deg,	J3=    -5.000 deg,
	J4=    40.000 deg,	J5=   -80.000 deg,	J6=   -60.000 deg
   GP2:
	UF : 0, UT : 1,	
	J1=     0.000  mm
};
/END
